"""The bridge over ROS 1 beside a node written with roscpp by hand: CPU per message, latency to the PLC.

usage: python -m benchmarks.bench_ros1 [--rounds N] [--json]

The node (ros1_node.cpp) does the work of ROBIN's: callbacks copy field by field into the same shared memory,
and a thread looks every millisecond for what the PLC has written. Both carry the same load by turns, from
and to a peer in C++ (ros1_load.cpp) that checks every message. Needs g++, Debian's rosmaster and roscpp.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import Any

from benchmarks import measure
from benchmarks.bench_dds import HERE, Carried, OverDds, compiled, run
from benchmarks.processes import RosGraph, environment
from rosplc_bench.compiling import CORE, FLAGS, SOURCES
from rosplc_bench.process import Side
from tests.interop.ros1.graph import LIBRARIES, lend

LOAD = (10, 1000, 2.5)  # topics each way, rate in Hz, seconds of a round
MESSAGES = {1000: 1000}  # of a round by rate in Hz


class OverRos1(OverDds):
    """A node by hand with roscpp."""

    node = "C++ node"
    distro = "noetic"
    waiting = "both sleep on their connections"

    def compile(self, folder: Path) -> None:
        """Compile node and peer."""
        self._folder = folder
        memory = folder / "memory.o"
        headers = [f"-I{each}" for each in (CORE, SOURCES)]
        compiled("gcc", *FLAGS, *headers, "-c", "-o", memory, HERE / "ros1_memory.c")
        for name, more in (("ros1_node", [memory]), ("ros1_load", [])):
            sources = [HERE / f"{name}.cpp", *more]
            compiled("g++", "-std=c++17", "-O2", "-o", folder / name, *sources, *LIBRARIES)

    @contextmanager
    def graph(self) -> Iterator[RosGraph]:
        """Give a graph with a master."""
        with lend() as master:
            yield RosGraph(0, "rospy", "noetic", variables=master.environment)

    def command(self, graph: RosGraph, what: Carried) -> list[str]:
        """Return how the node begins its command line."""
        return [str(self._folder / "ros1_node"), str(what.depth)]

    def environment(self, graph: RosGraph) -> dict[str, str]:
        """Return the node's environment."""
        return environment(0, graph.variables)

    def name(self, topic: str) -> str:
        """Return a topic's name in the middleware."""
        return topic

    @contextmanager
    def ros(self, plan: dict[str, Any], graph: RosGraph) -> Iterator[Side]:
        """Run the peer."""
        words = [plan[key] for key in ("topics", "count", "rate", "qos_depth")]
        command = [str(self._folder / "ros1_load"), *map(str, words)]
        with Side("ros1_load", command, environment(0, graph.variables)) as side:
            side.receive()
            yield side


if __name__ == "__main__":
    measure.main(partial(run, load=LOAD, messages=MESSAGES, over=OverRos1()), __doc__, 9)
