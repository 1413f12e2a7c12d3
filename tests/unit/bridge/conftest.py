"""A bridge over the in-process ROS graph, a peer node on that graph, and a stand-in for the PLC."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any

import pytest

from rosplc.bridge import Bridge
from rosplc.clock import SYSTEM, Clock
from rosplc.codec import Codec, Wire
from rosplc.config import parse_config
from rosplc.layout import Layout, Limits, compute_layout
from rosplc.model import TypeStore
from rosplc.ros import Publisher, Qos, goals
from rosplc.ros.memory import MemoryBackend, open_backend
from rosplc.shm import Attached, Namespace, Reader, Writer, attach

DOMAIN = 41
STORE = TypeStore.bundled("jazzy")
MESSAGES = goals.Messages(STORE, "example_interfaces/action/Fibonacci")
WATCHDOG_S = 100.0
STRING = "std_msgs/msg/String"
INT = "std_msgs/msg/Int32"
JOINTS = "sensor_msgs/msg/JointState"
BOTH = f"  /in: {{type: {INT}, to: plc}}\n  /out: {{type: {INT}, to: ros}}\n"


def wire(type_name: str, value: dict[str, Any]) -> bytes:
    """Return a message as it comes from a ROS node, with room for large strings and sequences."""
    layout = compute_layout(STORE, type_name, Limits(string=2000, sequence=200))
    return Codec(layout, Wire.CDR).encode(layout.pack(value))


def unwire(type_name: str, data: bytes) -> dict[str, Any]:
    """Return the content of a message that came to a ROS node."""
    layout = compute_layout(STORE, type_name, Limits(string=2000, sequence=200))
    return layout.to_dict(Codec(layout, Wire.CDR).decode(data))


def numbers(messages: list[bytes]) -> list[int]:
    """Return what Int32 messages hold."""
    return [unwire(INT, data)["data"] for data in messages]


class PlcTopic:
    """What a PLC does with one object: beats, reads, writes."""

    def __init__(self, namespace: Namespace, topic: str, layout: Layout, to_plc: bool) -> None:
        self.layout = layout
        self.attached: Attached = attach(namespace, topic, layout_id=layout.layout_id, write=True)
        self.reader: Reader | None = None
        self.writer: Writer | None = None
        if to_plc:
            self.reader = self.attached.reader("MainTask", observe=False, beat_ms=1000)
        else:
            self.writer = self.attached.writer(1000)
        self._record = bytearray(layout.size)

    def read(self, *, in_order: bool = False) -> dict[str, Any] | None:
        assert self.reader is not None
        found = self.reader.next(self._record) if in_order else self.reader.latest(self._record)
        return None if found is None else self.layout.to_dict(self._record)

    def write(self, value: dict[str, Any], **arguments: int) -> int:
        assert self.writer is not None
        return self.writer.publish(self.layout.pack(value), **arguments)


@dataclass
class Cell:
    """One bridge with everything around it; ``start`` may be called again after ``stop``."""

    namespace: Namespace
    peer: MemoryBackend
    bridge: Bridge | None = None
    received: dict[str, list[bytes]] = field(default_factory=dict)
    stamps: dict[str, list[int]] = field(default_factory=dict)
    _plc: list[PlcTopic] = field(default_factory=list)

    def config(self, topics: str, *, more: str = "", name: str = "cell", diagnostics: bool = False) -> str:
        return (
            f"bridge: {name}\nprefix: {self.namespace.prefix}\nros: {{backend: memory, domain: {DOMAIN}}}\n"
            f"beat: 20ms\ndiagnostics: {{enabled: {str(diagnostics).lower()}, period: 100ms}}\n{more}\n"
            f"topics:\n{topics}"
        )

    def make(self, topics: str, *, clock: Clock = SYSTEM, **arguments: Any) -> Bridge:
        return Bridge(parse_config(self.config(topics, **arguments)), clock=clock)

    def start(self, topics: str, **arguments: Any) -> Bridge:
        self.bridge = self.make(topics, **arguments)
        self.bridge.start()
        return self.bridge

    def stop(self) -> None:
        if self.bridge is not None:
            self.bridge.stop()
            self.bridge = None

    def plc(self, topic: str) -> PlcTopic:
        assert self.bridge is not None
        plan = self.bridge.project.topic(topic)
        self._plc.append(PlcTopic(self.namespace, topic, plan.layout, plan.direction.word == "to_plc"))
        return self._plc[-1]

    def publisher(self, topic: str, type_name: str, qos: Qos | None = None) -> Publisher:
        return self.peer.advertise(topic, type_name, qos or Qos(depth=1000))

    def listen(self, topic: str, type_name: str, qos: Qos | None = None) -> list[bytes]:
        messages = self.received.setdefault(topic, [])
        stamps = self.stamps.setdefault(topic, [])

        def on_message(data: bytes, stamp_ns: int) -> None:
            stamps.append(stamp_ns)
            messages.append(data)

        self.peer.subscribe(topic, type_name, qos or Qos(depth=1000), on_message)
        return messages

    def close(self) -> None:
        for topic in self._plc:
            topic.attached.close()
        self.stop()
        self.peer.close()


@pytest.fixture
def cell(shm_namespace: Namespace) -> Iterator[Cell]:
    """Give a cell of the test's own."""
    made = Cell(shm_namespace, open_backend(STORE, "peer", domain=DOMAIN))
    yield made
    made.close()
