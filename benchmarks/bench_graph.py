"""Memory of a node over dds while topics with new names come and go, storm after storm.

usage: python -m benchmarks.bench_graph [--storms N] [--topics N] [--bare]

Four processes advertise the topics in domain 101 and leave. The figures are anonymous memory in kB, before
and after the C library was asked to give back what is free. ``growth`` is what the storms after the second
added, in terms of what the first added; a leak per topic gives nearly as much with each storm.
With ``--bare`` the node is a participant of Cyclone DDS that only reads which publishers there are.
"""

from __future__ import annotations

import argparse
import ctypes
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

from cyclonedds.builtin import BuiltinDataReader, BuiltinTopicDcpsPublication
from cyclonedds.core import InstanceState
from cyclonedds.domain import DomainParticipant

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


def _bare() -> Callable[[], int]:
    """Return what counts the publishers in the domain, of a participant without a node."""
    participant = DomainParticipant(_DOMAIN)
    reader: Any = BuiltinDataReader(participant, BuiltinTopicDcpsPublication)
    alive: set[int] = set()

    def count() -> int:
        while samples := reader.take(N=500):
            for sample in samples:
                there = sample.sample_info.instance_state == InstanceState.Alive
                (alive.add if there else alive.discard)(sample.sample_info.instance_handle)
        return len(alive) if participant else 0  # which must outlive its reader

    return count


def _watch() -> Callable[[], int]:
    """Return what counts the topics that a node sees."""
    graph = _node("watcher").graph
    return lambda: sum(topic.startswith("/storm_") for topic in graph().topics)


def _anonymous() -> int:
    lines = Path("/proc/self/status").read_text(encoding="ascii", errors="replace").splitlines()
    return int(next(line for line in lines if line.startswith("RssAnon")).split()[1])


def main() -> None:
    """Run the storms and print each one's figures."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else "")
    parser.add_argument("--storms", type=int, default=5)
    parser.add_argument("--topics", type=int, default=4000)
    parser.add_argument("--bare", action="store_true")
    parser.add_argument("--advertise", help=argparse.SUPPRESS)
    given = parser.parse_args()
    if given.advertise:
        _advertise(given.advertise, given.topics)
        return
    seen = _bare() if given.bare else _watch()
    least, levels = seen(), [_anonymous()]

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
        wait_for(lambda: seen() <= least, seconds=600, every=0.5)
        resident = _anonymous()
        ctypes.CDLL(None).malloc_trim(0)
        levels.append(_anonymous())
        print(f"after storm {storm + 1}: {resident} kB, {levels[-1]} kB without what is free", flush=True)
    if len(levels) > 3:
        growth = (levels[-1] - levels[2]) / (levels[1] - levels[0])
        print(f"before: {levels[0]} kB; growth: {growth:.2f} in {len(levels) - 3} storms")


if __name__ == "__main__":
    main()
