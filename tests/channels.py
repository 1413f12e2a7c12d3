"""Channels of bundled types."""

from __future__ import annotations

from typing import Any

from rosplc.described import description_of
from rosplc.layout import Layout, Limits, compute_layout
from rosplc.model import TypeStore
from rosplc.shm import Direction, Namespace, OwnedChannel

__all__ = ["STORE", "Side", "layout_of"]

STORE = TypeStore.bundled("jazzy")


def layout_of(type_name: str, **limits: Any) -> Layout:
    """Return the layout of a bundled type."""
    return compute_layout(STORE, type_name, Limits(**limits))


class Side:
    """A bridge's hand on one topic of a bundled type."""

    def __init__(
        self,
        namespace: Namespace,
        topic: str,
        layout: Layout,
        direction: Direction,
        slots: int = 4,
        *,
        bridge: str = "test",
        beat_ms: int = 50,
    ) -> None:
        self.namespace, self.topic, self.layout = namespace, topic, layout
        description = description_of(layout, topic, direction, bridge=bridge)
        self.channel = OwnedChannel.open(namespace, description, record_size=layout.size, slots=slots)
        if direction is Direction.TO_PLC:
            self.writer = self.channel.writer(beat_ms=beat_ms)
        else:
            self.reader = self.channel.reader(beat_ms=beat_ms)

    def send(self, **fields: Any) -> int:
        """Publish a message towards the PLC, with the stamp 7."""
        return self.writer.publish(self.layout.pack(fields), stamp_ns=7)

    def take(self) -> Any:
        """Return the next message from the PLC, with its slot's header; None if there is none."""
        record = bytearray(self.layout.size)
        info = self.reader.next(record)
        return None if info is None else (info, self.layout.view(record))

    def beat(self) -> None:
        """Show that the bridge lives."""
        (self.writer if hasattr(self, "writer") else self.reader).beat()

    def close(self) -> None:
        """End in order: claims are given back, the object stays."""
        self.channel.close()
