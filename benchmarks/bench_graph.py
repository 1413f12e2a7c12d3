"""Memory of a node over dds while topics with new names come and go, storm after storm.

usage: python -m benchmarks.bench_graph [--storms N] [--topics N]

Four processes advertise the topics in domain 101 and leave. The figures are anonymous memory in kB, before
and after the C library was asked to give back what is free. ``growth`` is what the storms after the second
added, in terms of what the first added; a leak per topic gives nearly as much with each storm.
"""

from __future__ import annotations

import argparse
import ctypes
import subprocess
import sys
from pathlib import Path

from rosplc.model import TypeStore
from rosplc.ros import Backend, Qos, open_backend
from tests.lib.waiting import wait_for

_DOMAIN, _PROCESSES = 101, 4
_INT = "std_msgs/msg/Int32"


def _node(name: str) -> Backend:
    return open_backend("dds", TypeStore.bundled("jazzy"), name, domain=_DOMAIN)


def _advertise(name: str, count: int) -> None:
    node = _node(name)
    for number in range(count):
        node.advertise(f"/{name}/topic_number_{number}", _INT, Qos())
    sys.stdin.readline()
    node.close()


def _anonymous() -> int:
    lines = Path("/proc/self/status").read_text(encoding="ascii", errors="replace").splitlines()
    return int(next(line for line in lines if line.startswith("RssAnon")).split()[1])


def main() -> None:
    """Run the storms and print each one's figures."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else "")
    parser.add_argument("--storms", type=int, default=5)
    parser.add_argument("--topics", type=int, default=4000)
    parser.add_argument("--advertise", help=argparse.SUPPRESS)
    given = parser.parse_args()
    if given.advertise:
        _advertise(given.advertise, given.topics)
        return
    node, levels = _node("watcher"), [_anonymous()]

    def seen() -> int:
        return sum(topic.startswith("/storm_") for topic in node.graph().topics)

    for storm in range(given.storms):
        command = [
            sys.executable,
            "-m",
            __spec__.name,
            "--topics",
            str(given.topics // _PROCESSES),
            "--advertise",
        ]
        peers = [
            subprocess.Popen([*command, f"storm_{storm}_{number}"], stdin=subprocess.PIPE)
            for number in range(_PROCESSES)
        ]
        wait_for(lambda: seen() >= given.topics // _PROCESSES * _PROCESSES, seconds=600, every=0.5)
        for peer in peers:
            peer.communicate()
        wait_for(lambda: not seen(), seconds=600, every=0.5)
        resident = _anonymous()
        ctypes.CDLL(None).malloc_trim(0)
        levels.append(_anonymous())
        print(f"after storm {storm + 1}: {resident} kB, {levels[-1]} kB without what is free", flush=True)
    node.close()
    if len(levels) > 3:
        growth = (levels[-1] - levels[2]) / (levels[1] - levels[0])
        print(f"before: {levels[0]} kB; growth: {growth:.2f} in {len(levels) - 3} storms")


if __name__ == "__main__":
    main()
