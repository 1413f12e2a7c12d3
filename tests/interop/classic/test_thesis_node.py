"""A ROS 1 node written after the source thesis' class, on the other side of a classic topic's memory."""

from __future__ import annotations

import secrets
import struct
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from rosplc.bridge import Bridge
from rosplc.config import parse_config
from rosplc.model import TypeStore
from rosplc.ros import DEFAULT
from rosplc.ros.memory import MemoryBackend, open_backend
from tests.classic_cell import Program, build, remove
from tests.interop.ros1.graph import PACKAGES, Graph, Peer
from tests.lib.waiting import wait_for

pytestmark = [
    pytest.mark.needs(*PACKAGES),
    pytest.mark.verifies("classic", own="a node based on the class in the thesis"),
]

TWIST = "geometry_msgs/msg/Twist"
LIBRARIES = (
    "-lroscpp", "-lrosconsole", "-lroscpp_serialization", "-lrostime", "-lcpp_common", "-lboost_thread",
    "-lboost_system", "-lpthread",
)  # fmt: skip


@pytest.fixture(scope="module")
def program() -> Path:
    """Compile the node."""
    return build("thesis_node.cpp", ["g++", "-std=c++17", "-O1"], *LIBRARIES)


class Cell:
    """A bridge on the in-process graph with one classic Twist topic, and a ROS 1 graph beside it."""

    def __init__(self, program: Path, to: str) -> None:
        self.name = f"twist_{secrets.token_hex(4)}"
        self.program = program
        text = (
            f"prefix: {self.name}\nros: {{distro: noetic}}\ntopics:\n  /{self.name}: "
            f"{{type: {TWIST}, to: {to}, classic: {{recover_after: 200ms, wait: 2ms}}}}\n"
        )
        domain, store = secrets.randbelow(200), TypeStore.bundled("noetic")
        self.ros: MemoryBackend = open_backend(store, "peer", domain=domain)
        self.side = open_backend(store, "bridge", domain=domain)
        self.bridge = Bridge(parse_config(text), self.side)
        self.graph = Graph()
        self.peer: Peer = self.graph.peer("rospy", "beside")
        self.got: list[float] = []
        if to == "ros":
            self.ros.subscribe(f"/{self.name}", TWIST, DEFAULT, self._on_message)
        else:
            self._publisher = self.ros.advertise(f"/{self.name}", TWIST, DEFAULT)

    def _on_message(self, data: bytes, _stamp_ns: int) -> None:
        values = set(struct.unpack("<6d", data))
        self.got.append(values.pop() if len(values) == 1 else -1.0)

    def publish(self, value: float) -> None:
        """Publish on the bridge's side."""
        self._publisher.write(twist(value), 0)

    def node(self, way: str, **environment: object) -> Program:
        """Start the node."""
        variables = {**self.graph.environment, **environment}
        return Program([self.program, way, self.name], variables)

    @property
    def recovered(self) -> int:
        """How often the lock was freed."""
        classic = self.bridge.status().topic(f"/{self.name}").classic
        assert classic is not None
        return classic.recovered

    def __enter__(self) -> Cell:
        self.bridge.start()
        return self

    def __exit__(self, *_: object) -> None:
        self.bridge.stop()
        self.ros.close()
        self.side.close()
        self.graph.close()
        remove(self.name)


@pytest.fixture
def to_plc(program: Path) -> Iterator[Cell]:
    """Give a bridge that writes, for nodes that read."""
    with Cell(program, "plc") as cell:
        yield cell


@pytest.fixture
def to_ros(program: Path) -> Iterator[Cell]:
    """Give a bridge that reads, for nodes that write."""
    with Cell(program, "ros") as cell:
        yield cell


def twist(value: float) -> bytes:
    """Return a Twist as ROS 1 sends it, with one value in all fields."""
    return struct.pack("<6d", *[value] * 6)


def test_the_node_reads_what_the_bridge_writes_however_often_it_starts(to_plc: Cell) -> None:
    """Each start of the node removes the semaphore twice, each end the memory too; the bridge follows."""
    inbox = to_plc.peer.subscribe(f"/{to_plc.name}", TWIST)
    for value in (1.0, 2.0, 3.0):
        with to_plc.node("read") as node:

            def arrived(value: float = value) -> bool:
                to_plc.publish(value)
                time.sleep(0.02)
                return twist(value) in inbox.payloads()

            wait_for(arrived, f"message {value} in the ROS 1 graph")
            node.end()


def test_the_bridge_reads_what_the_node_writes_however_often_it_starts(to_ros: Cell) -> None:
    """The node's memory may vanish and come back; its messages arrive, and none is invented or torn."""
    outbox = to_ros.peer.advertise(f"/{to_ros.name}", TWIST)
    for value in (1.0, 2.0, 3.0):
        with to_ros.node("write") as node:

            def arrived(value: float = value) -> bool:
                outbox.write(twist(value))
                time.sleep(0.02)
                return value in to_ros.got

            wait_for(arrived, f"message {value}")
            node.end()
    # No zeros of new memories, and no message twice but where the node wrote it into a new memory.
    assert set(to_ros.got) == {1.0, 2.0, 3.0}


def test_a_node_killed_while_it_reads(to_plc: Cell) -> None:
    """A successor of a node that died inside the lock makes a lock of its own, and goes on."""
    inbox = to_plc.peer.subscribe(f"/{to_plc.name}", TWIST)
    for round_number in range(3):
        with to_plc.node("read", HOLD=3) as node:
            node.wait_line("inside")
        value = 10.0 + round_number
        to_plc.publish(value)
        wait_for(lambda wanted=round_number + 1: to_plc.recovered == wanted, "the lock to be freed")
        with to_plc.node("read"):
            wait_for(lambda value=value: twist(value) in inbox.payloads(), "the state after the restart")


def test_a_node_killed_while_it_writes(to_ros: Cell) -> None:
    """What it left half written never arrives; the next whole message does."""
    outbox = to_ros.peer.advertise(f"/{to_ros.name}", TWIST)
    for round_number in range(3):
        value = 10.0 * (round_number + 1)
        with to_ros.node("write", HOLD=1) as node:

            def inside(node: Program = node, value: float = value) -> bool:
                outbox.write(twist(value))
                time.sleep(0.02)
                return "inside" in node.said()

            wait_for(inside, "the node to stop inside")
        if round_number:  # in the first round its successor comes before the lock is freed
            wait_for(lambda wanted=round_number: to_ros.recovered >= wanted, "the lock to be freed")
        assert -1.0 not in to_ros.got and value not in to_ros.got
        with to_ros.node("write"):

            def arrived(value: float = value) -> bool:
                outbox.write(twist(value + 1))
                time.sleep(0.02)
                return value + 1 in to_ros.got

            wait_for(arrived, "the successor's message")
    assert -1.0 not in to_ros.got
