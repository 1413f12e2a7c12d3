"""What tests of channels share: descriptions, records that show tearing, and child processes."""

from __future__ import annotations

import struct
import subprocess
import sys
from pathlib import Path
from typing import Any

from rosplc.described import description_of
from rosplc.layout import Layout, Limits, compute_layout
from rosplc.model import TypeStore
from rosplc.shm import Description, Direction, Namespace, OwnedChannel

__all__ = [
    "LAYOUT",
    "STORE",
    "Side",
    "describe",
    "is_torn",
    "layout_of",
    "open_channel",
    "pattern",
    "start_child",
    "until",
]

LAYOUT = "0123456789abcdef"
STORE = TypeStore.bundled("jazzy")
_ROOT = Path(__file__).resolve().parents[1]


def describe(
    topic: str = "/robot1/cmd_vel", direction: Direction = Direction.TO_PLC, layout_id: str = LAYOUT
) -> Description:
    """Return a self-description of a made-up type."""
    return Description(
        topic=topic,
        type="test_msgs/msg/Bytes",
        distro="jazzy",
        direction=direction,
        limits={"string": 80, "sequence": 16, "fields": {}},
        layout_id=layout_id,
        bridge="test",
        definition="uint64[] data\n",
    )


def open_channel(
    namespace: Namespace,
    direction: Direction = Direction.TO_PLC,
    *,
    topic: str = "/robot1/cmd_vel",
    record_size: int = 64,
    slots: int = 4,
    layout_id: str = LAYOUT,
) -> OwnedChannel:
    """Own a channel of a made-up type."""
    return OwnedChannel.open(
        namespace, describe(topic, direction, layout_id), record_size=record_size, slots=slots
    )


def pattern(number: int, size: int) -> bytes:
    """Return a record of ``size`` bytes (a multiple of eight) whose every eight bytes are ``number``."""
    return struct.pack("<Q", number) * (size // 8)


def is_torn(record: bytes | bytearray) -> bool:
    """Return whether a pattern holds parts of two messages."""
    return bytes(record[8:]) != bytes(record[:-8])


def start_child(script: str, *arguments: object) -> subprocess.Popen[str]:
    """Start a Python process on a script that sees this checkout; its stdin and stdout are pipes."""
    return subprocess.Popen(
        [sys.executable, "-c", script, *map(str, arguments)],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
        cwd=_ROOT,
    )


def until(child: subprocess.Popen[str], word: str) -> str:
    """Read a child's lines up to one that begins with ``word``, and return it; the test's timeout watches."""
    assert child.stdout is not None
    for line in child.stdout:
        if line.startswith(word):
            return line.strip()
    raise AssertionError(f"the child ended without saying {word!r}")


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
