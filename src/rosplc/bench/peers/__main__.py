"""Run one side of one contender: ``python -m rosplc.bench.peers MODULE SIDE ARGUMENTS``."""

from __future__ import annotations

import importlib
import signal
import sys

from rosplc.bench.orphan import die_with_parent

MODULES = ("channel", "typed_channel", "semaphore", "modbus", "opcua", "iceoryx")


def main() -> None:
    """Find the module by its name and let it run."""
    die_with_parent()
    # Ctrl-C is for the program that measures; this one ends with its input.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    module, side, *arguments = sys.argv[1:]
    if module not in MODULES or side not in ("A", "B"):
        sys.exit(f"no peer {module} {side}")
    importlib.import_module(f"rosplc.bench.peers.{module}").main(side, arguments)


if __name__ == "__main__":
    main()
