"""What the drawings of the format show, taken from objects that the C core made.

Nothing here states a number of the format. Each scene makes a real object in a folder that goes away again,
lets the C core write into it, and returns the words that are there.
"""

from __future__ import annotations

import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from rosplc.layout import Layout, compute_layout
from rosplc.model import TypeStore
from rosplc.shm import Description, Direction, Namespace, OwnedChannel, Region, Writer, attach, distance
from rosplc.shm.constants import IDENTITY, WRITER_LINE

TOPIC, TYPE = "/cmd_vel", "geometry_msgs/msg/Twist"
STORE = TypeStore.bundled("jazzy")


def layout() -> Layout:
    """Return the record of the drawings' topic."""
    return compute_layout(STORE, TYPE)


@contextmanager
def channel(folder: Path, layout_id: str | None = None) -> Iterator[OwnedChannel]:
    """A bridge's channel in a folder; a layout id other than the record's stands for another definition."""
    record = layout()
    description = Description(
        TOPIC,
        TYPE,
        "jazzy",
        Direction.TO_PLC,
        {"string": 80, "sequence": 16, "fields": {}},
        layout_id or record.layout_id,
        "cell1",
        STORE.definition_text(TYPE),
    )
    namespace = Namespace("rosplc", folder)
    with OwnedChannel.open(namespace, description, record_size=record.size) as opened:
        yield opened


@contextmanager
def folder() -> Iterator[Path]:
    """A folder that takes the place of /dev/shm."""
    with tempfile.TemporaryDirectory(prefix="rosplc-drawing-") as name:
        yield Path(name)


def slot_at(opened: OwnedChannel, sequence: int) -> int:
    """Return the offset of the slot in which a message lives."""
    identity = opened.identity
    return identity.slots_offset + sequence % identity.slot_count * identity.slot_stride


def sequences(opened: OwnedChannel) -> list[int]:
    """Return the sequence number in each slot."""
    return [opened.region.word(slot_at(opened, slot)) for slot in range(opened.identity.slot_count)]


def publish(writer: Writer, count: int) -> None:
    """Publish messages of zeros."""
    for _ in range(count):
        writer.publish(bytes(layout().size))


def seal(region: Region, offset: int) -> None:
    """Do what the writer does first with a slot, and no more: as if it stopped there."""
    region.store(offset, 0)  # a slot begins with its sequence


@dataclass(frozen=True)
class Torn:
    """A reader that was interrupted in its copy, and what it finds."""

    slots: int
    head: int
    before: list[int]  # the slots' sequences when the copy begins
    published: list[int]
    head_after: int
    after: list[int]
    window: int
    retry: int


def torn() -> Torn:
    """Let a writer come round to the slot that a reader copies."""
    with folder() as place, channel(place) as opened:
        writer = opened.writer()
        publish(writer, 7)
        head, before = writer.head, sequences(opened)
        publish(writer, opened.identity.slot_count - 1)
        seal(opened.region, slot_at(opened, head))  # the next message lives in that very slot
        after = opened.region.word(WRITER_LINE["head"])
        window = opened.identity.slot_count - 2
        assert distance(head, after, opened.identity.slot_count) > window
        buffer = bytearray(layout().size)
        with attach(Namespace("rosplc", place), TOPIC) as reading:
            newest = reading.reader().peek(buffer)
        assert newest is not None
        return Torn(
            opened.identity.slot_count,
            head,
            before,
            list(range(head + 1, after + 1)),
            after,
            sequences(opened),
            window,
            newest.sequence,
        )


def rounds(count: int) -> list[list[int]]:
    """Return the slots' sequences after each of some publications."""
    with folder() as place, channel(place) as opened:
        writer = opened.writer()
        found = [sequences(opened)]
        for _ in range(count):
            publish(writer, 1)
            found.append(sequences(opened))
        return found


@dataclass(frozen=True)
class Restart:
    """One object through two bridges, and what a third one leaves of it that brings another layout."""

    head: int
    adopted: bool
    adopted_head: int
    replaced: bool
    old_state: int
    new_head: int


def restart() -> Restart:
    """Keep an object mapped, as a PLC does, while bridges come and go."""
    with folder() as place:
        with channel(place) as opened:
            publish(opened.writer(), 41)
            head = opened.snapshot().writer.head
        with attach(Namespace("rosplc", place), TOPIC) as plc:
            with channel(place) as opened:
                adopted, adopted_head = opened.adopted, opened.writer().head
            with channel(place, layout_id="00112233445566ff") as opened:
                replaced, new_head = not opened.adopted, opened.writer().head
            state = plc.region.word(IDENTITY["state"])
    return Restart(head, adopted, adopted_head, replaced, state, new_head)
