"""Run one side of one contender."""

from __future__ import annotations

import sys

from rosplc_bench.process import follow_parent


def main() -> None:
    """Import what the contender needs, and nothing else, and run it."""
    follow_parent()
    name, side, *arguments = sys.argv[1:]
    if name == "modbus":
        from rosplc_bench.peers import modbus as peer
    elif name == "opcua":
        from rosplc_bench.peers import opcua as peer  # type: ignore[no-redef]
    elif name == "iceoryx":
        from rosplc_bench.peers import iceoryx as peer  # type: ignore[no-redef]
    else:
        from rosplc_bench.peers import memory

        {"channel": memory.channel, "typed_channel": memory.typed_channel, "semaphore": memory.semaphore}[
            name
        ](side, arguments)
        return
    peer.main(side, arguments)


if __name__ == "__main__":
    main()
