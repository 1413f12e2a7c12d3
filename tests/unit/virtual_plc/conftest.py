"""The bridge's side of a channel, made by hand."""

from __future__ import annotations

import pytest

from rosplc.layout import Layout, Limits, compute_layout
from rosplc.model import TypeStore
from rosplc.shm import Description, Direction, Namespace, OwnedChannel
from rosplc.virtual_plc.scan import Scan, enter_scan, leave_scan

STORE = TypeStore.bundled("jazzy")


def layout_of(type_name: str, **limits) -> Layout:
    return compute_layout(STORE, type_name, Limits(**limits))


class Side:
    """A bridge's hand on one topic."""

    def __init__(
        self, namespace: Namespace, topic: str, layout: Layout, direction: Direction, slots: int = 4
    ):
        self.namespace, self.topic, self.layout = namespace, topic, layout
        description = Description(
            topic=topic,
            type=layout.type_name,
            distro="jazzy",
            direction=direction,
            limits=layout.limits.to_dict(),
            layout_id=layout.layout_id,
            bridge="test",
            definition=STORE.definition_text(layout.type_name),
        )
        self.channel = OwnedChannel.open(namespace, description, record_size=layout.size, slots=slots)
        if direction is Direction.TO_PLC:
            self.writer = self.channel.writer(beat_ms=50)
        else:
            self.reader = self.channel.reader(beat_ms=50)

    def send(self, **fields) -> int:
        return self.writer.publish(self.layout.pack(fields), stamp_ns=7)

    def take(self):
        record = bytearray(self.layout.size)
        info = self.reader.next(record)
        return None if info is None else (info, self.layout.view(record))

    def close(self) -> None:
        self.channel.close()


@pytest.fixture
def side(shm_namespace):
    """Make bridge sides: ``side("/t", "std_msgs/msg/Int32", Direction.TO_PLC)``."""
    sides = []

    def make(topic: str, type_name: str, direction: Direction, *, slots: int = 4, **limits) -> Side:
        sides.append(Side(shm_namespace, topic, layout_of(type_name, **limits), direction, slots))
        return sides[-1]

    yield make
    for each in sides:
        each.close()


class Scans:
    """Runs one block per scan at times that the test chooses."""

    def __init__(self):
        self.now, self.number = 1_000_000_000, 0

    def __call__(self, *blocks, ms: int = 10) -> None:
        self.now += ms * 1_000_000
        self.number += 1
        enter_scan(Scan("Test", self.number, self.now))
        try:
            for block in blocks:
                block()
        finally:
            leave_scan()


@pytest.fixture
def scans():
    return Scans()
