"""Classic blocks and a ROS 1 node written after the source thesis' class: ROS 1 ↔ node ↔ memory ↔ PLC."""

from __future__ import annotations

import struct
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from tests.classic_cell import Program, build
from tests.interop.classic.test_thesis_node import LIBRARIES
from tests.interop.ros1.graph import PACKAGES, Graph, lend
from tests.verification.classic_cell import TWIST, ClassicCell
from tests.verification.plc_cell import pattern

pytestmark = pytest.mark.needs(*PACKAGES)

WATCHDOG_S = 100.0


@pytest.fixture(scope="module")
def program() -> Path:
    """Compile the node."""
    return build("thesis_node.cpp", ["g++", "-std=c++17", "-O1"], *LIBRARIES)


@pytest.fixture
def graph() -> Iterator[Graph]:
    with lend() as made:
        yield made


class Joint:
    """A PLC that scans while it waits, and nodes on the other side of its memories."""

    def __init__(self, program: Path, graph: Graph, cell: ClassicCell) -> None:
        self.program, self.graph, self.cell = program, graph, cell

    def node(self, way: str, topic: str, **environment: object) -> Program:
        """Start the thesis' node on a topic of the PLC."""
        command = [self.program, way, self.cell.name(topic)]
        return Program(command, {**self.graph.environment, **environment})

    def scan_until(self, condition: Callable[[], object], what: str) -> None:
        """Let the PLC run until something holds."""
        deadline = time.monotonic() + WATCHDOG_S
        while not condition():
            assert time.monotonic() < deadline, f"still waiting for {what}"
            self.cell.scan()
            time.sleep(0.002)


def test_the_node_and_the_blocks_exchange_messages(program: Path, graph: Graph) -> None:
    """Values cross both ways, and again after the node has ended in order, and was killed inside the lock."""
    with ClassicCell() as cell:
        joint = Joint(program, graph, cell)
        peer = graph.peer("rospy", "beside")
        outbox = peer.advertise(f"/{cell.name('/in')}", TWIST)
        inbox = peer.subscribe(f"/{cell.name('/out')}", TWIST)

        def both(number: float, *, orderly: bool) -> None:
            with joint.node("write", "/in") as writer, joint.node("read", "/out") as reader:
                cell.put("/out", pattern(-number))

                def arrived() -> bool:
                    outbox.write(struct.pack("<6d", *[number] * 6))
                    return cell.record("/in") == pattern(number)

                joint.scan_until(arrived, f"{number} in the PLC")
                sent = struct.pack("<6d", *[-number] * 6)
                joint.scan_until(lambda: sent in inbox.payloads(), f"{-number} in ROS")
                cell.scan(3)
                assert cell.get("/in", "xValid", "udiError") == (True, 0)
                if orderly:  # the class' destructor removes memory and semaphore
                    writer.end()
                    reader.end()

        both(1, orderly=True)
        both(2, orderly=True)
        both(3, orderly=False)
        for topic, way, nth in (("/in", "write", 1), ("/out", "read", 3)):
            with joint.node(way, topic, HOLD=nth) as node:

                def inside(node: Program = node) -> bool:
                    outbox.write(struct.pack("<6d", *[50.0] * 6))
                    return "inside" in node.said()

                joint.scan_until(inside, f"{way} to stand inside")
                before = cell.get(topic, "udiTimeouts")
                cell.scan(50)
                assert cell.get(topic, "udiTimeouts") - before <= 51
        both(4, orderly=True)
        assert cell.machine.counters().sem_endless == 0
