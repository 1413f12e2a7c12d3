"""Valid objects: their contents, and what a reader must take from them.

Expected results are written by hand, case by case. They are not computed by a reader.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from region_image import Image

__all__ = ["TOP", "cases", "reading"]

TOP = 2**32 - 1


def reading(
    image: Image,
    order: str,
    last: int,
    *messages: tuple[int, int],
    discontinuities: int = 0,
    flags: int = 0,
    clock: int = 1,
) -> dict[str, Any]:
    """Return what a reader that has taken ``last`` takes until nothing is new.

    Args:
        image: The object.
        order: "newest" or "in_order".
        last: The sequence taken last; 0: the reader of a latched topic.
        messages: Pairs of a sequence and the messages lost before it.
        discontinuities: How often the stream broke.
        flags: The messages' flags.
        clock: The clock of the messages' stamps.
    """
    return {
        "order": order,
        "last": last,
        "messages": [image.message(s, lost=lost, flags=flags, clock=clock) for s, lost in messages],
        "last_after": messages[-1][0] if messages else last,
        "lost": sum(lost for _, lost in messages),
        "discontinuities": discontinuities,
    }


def cases() -> Iterator[tuple[str, str, Image, list[dict[str, Any]], dict[str, Any]]]:
    """Yield name, what it is about, image, readings, and members to add or replace."""
    image = Image()
    image.set(writer_epoch=0, writer_beat=0, writer_beat_ms=0, writer_rule=0)
    yield "empty", "nobody has written yet", image, [reading(image, o, 0) for o in ("newest", "in_order")], {}

    image = Image().publish(1, flags=1)
    both = [reading(image, order, 0, (1, 0), flags=1) for order in ("newest", "in_order")]
    yield "one-message", "the first message of a writer that has just started", image, both, {}

    image = Image().publish(1, 2, 3, 4, 5)
    readings = [
        reading(image, "newest", 5),
        reading(image, "newest", 4, (5, 0)),
        reading(image, "newest", 1, (5, 3)),
        reading(image, "newest", 0, (5, 0)),
        reading(image, "in_order", 5),
        reading(image, "in_order", 4, (5, 0)),
        reading(image, "in_order", 2, (3, 0), (4, 0), (5, 0)),
        reading(image, "in_order", 1, (3, 1), (4, 0), (5, 0)),
        reading(image, "in_order", 0, (3, 0), (4, 0), (5, 0)),
    ]
    yield (
        "full-ring",
        "N slots hold N - 1 messages; the oldest slot is the next to be written",
        image,
        readings,
        {},
    )

    image = Image(slots=8).publish(*range(90, 101))
    readings = [
        reading(image, "newest", 90, (100, 9)),
        reading(image, "in_order", 93, *((s, 0) for s in range(94, 101))),
        reading(image, "in_order", 92, (94, 1), *((s, 0) for s in range(95, 101))),
        reading(image, "in_order", 50, (94, 43), *((s, 0) for s in range(95, 101))),
    ]
    yield (
        "lapped",
        "a reader that was slower than the writer, by one message and by many",
        image,
        readings,
        {},
    )

    image = Image().publish(97, 98, 99, 100)
    readings = [
        reading(image, "newest", 5_000_000, (100, 0), discontinuities=1),
        reading(image, "in_order", 5_000_000, (100, 0), discontinuities=1),
        reading(image, "in_order", 96 + 2**31, (100, 0), discontinuities=1),
        reading(image, "in_order", 97 + 2**31, (98, 2**31 - 4), (99, 0), (100, 0)),
    ]
    yield "discontinuity", "last belongs to another stream: on with the newest", image, readings, {}

    yield from _wrap()
    yield from _geometry()
    yield from _unfinished()
    yield from _tolerated()


def _wrap() -> Iterator[tuple[str, str, Image, list[dict[str, Any]], dict[str, Any]]]:
    image = Image().publish(TOP - 4, TOP - 3, TOP - 2, TOP - 1)
    readings = [
        reading(image, "newest", TOP - 2, (TOP - 1, 0)),
        reading(image, "in_order", TOP - 4, (TOP - 3, 0), (TOP - 2, 0), (TOP - 1, 0)),
        reading(image, "in_order", 0, (TOP - 1, 0)),
    ]
    yield "wrap-before", "head is 2^32 - 2", image, readings, {}

    image = Image().publish(TOP - 3, TOP - 2, TOP - 1, TOP)
    readings = [
        reading(image, "newest", TOP - 3, (TOP, 2)),
        reading(image, "in_order", TOP - 1, (TOP, 0)),
        reading(image, "in_order", TOP - 4, (TOP - 2, 1), (TOP - 1, 0), (TOP, 0)),
    ]
    yield "wrap-last", "head is 2^32 - 1, the last sequence before the wrap", image, readings, {}

    image = Image().publish(TOP - 2, TOP - 1, TOP, 4)
    readings = [
        reading(image, "newest", TOP, (4, 0)),
        reading(image, "newest", TOP - 2, (4, 2)),
        reading(image, "newest", 0, (4, 0)),
        reading(image, "in_order", TOP - 2, (TOP - 1, 0), (TOP, 0), (4, 0)),
        reading(image, "in_order", TOP - 4, (TOP - 1, 2), (TOP, 0), (4, 0)),
    ]
    yield "wrap-first", "head is N, the first sequence after the wrap", image, readings, {}

    image = Image(slots=8).publish(TOP - 3, TOP - 2, TOP - 1, TOP, 8, 9, 10, 11)
    readings = [
        reading(image, "newest", TOP, (11, 3)),
        reading(image, "in_order", TOP - 1, (TOP, 0), *((s, 0) for s in range(8, 12))),
        reading(
            image, "in_order", TOP - 6, (TOP - 2, 3), (TOP - 1, 0), (TOP, 0), *((s, 0) for s in range(8, 12))
        ),
    ]
    yield "wrap-after", "the oldest messages left lie before the wrap", image, readings, {}

    image = Image().publish(TOP - 5, TOP - 4, TOP - 3)
    readings = [reading(image, "newest", 0, (TOP - 3, 0))]
    yield "wrap-latched", "last = 0 is far from every head, not just behind this one", image, readings, {}


def _geometry() -> Iterator[tuple[str, str, Image, list[dict[str, Any]], dict[str, Any]]]:
    for power in range(2, 17):
        slots = 2**power
        image = Image(slots=slots, record_size=1).publish(1, 2, 3)
        readings = [reading(image, "newest", 1, (3, 1)), reading(image, "in_order", 1, (2, 0), (3, 0))]
        yield f"slots-{slots}", f"N is {slots}", image, readings, {}
    for size in (1, 64, 65, 4096):
        image = Image(record_size=size).publish(8, 9)
        readings = [reading(image, "newest", 8, (9, 0))]
        yield f"record-{size}", f"a record of {size} bytes", image, readings, {}

    image = Image(direction=2).publish(6, 7, clock=3)
    image.line(0, claim=0xC1A1, beat=9, beat_ms=1000, taken=6, generation=0x5EED1234, lost=2, sinks=3)
    readings = [reading(image, "in_order", 6, (7, 0), clock=3)]
    yield "to-ros", "a channel towards ROS, whose line 0 is the bridge's", image, readings, {}

    image = Image().publish(2, 3, clock=0)
    yield (
        "no-stamp",
        "messages without a time stamp",
        image,
        [reading(image, "newest", 2, (3, 0), clock=0)],
        {},
    )

    image = Image().publish(3, 4, flags=7)
    yield "all-flags", "every flag is set", image, [reading(image, "newest", 3, (4, 0), flags=7)], {}

    image = Image(gap=256).publish(1, 2)
    yield (
        "gap-before-slots",
        "slots_offset is larger than it must be",
        image,
        [reading(image, "newest", 1, (2, 0))],
        {},
    )

    image = Image().publish(1, 2)
    image.set(object_size=len(image.data) + 64)
    image.data += bytes(64)
    yield (
        "object-size-larger",
        "object_size is larger than it must be",
        image,
        [reading(image, "newest", 1, (2, 0))],
        {},
    )

    image = Image().publish(1, 2)
    yield (
        "page-rounded",
        "the file was rounded up to pages",
        image,
        [reading(image, "newest", 1, (2, 0))],
        {"size": 8192},
    )


def _unfinished() -> Iterator[tuple[str, str, Image, list[dict[str, Any]], dict[str, Any]]]:
    image = Image().publish(2, 3, 4, 5)
    image.slot(2, sequence=0)
    image.data[image.slots_offset + 2 * image.stride + 64 :][:6] = b"\xff" * 6
    at = image.slots_offset + 2 * image.stride + 64
    image.data[at : at + 6] = b"\xff" * 6
    readings = [reading(image, "newest", 4, (5, 0)), reading(image, "in_order", 2, (3, 0), (4, 0), (5, 0))]
    yield (
        "writer-killed",
        "a writer died in the middle of message 6: every other is there",
        image,
        readings,
        {},
    )

    image = Image().publish(2, 3, 4, 5, 6).set(head=5)
    readings = [reading(image, "newest", 4, (5, 0)), reading(image, "in_order", 2, (3, 0), (4, 0), (5, 0))]
    yield "writer-killed-late", "message 6 is complete, but never was published", image, readings, {}

    image = Image(direction=2).publish(3, 4, 5, 6, 7).set(head=6, writer_rule=2)
    readings = [
        reading(image, "newest", 5, (6, 0)),
        reading(image, "in_order", 4, (5, 0), (6, 0)),
        reading(image, "in_order", 3, (5, 1), (6, 0)),
    ]
    yield "delayed-writer", "writer_rule 2: slots hold one message less (M23)", image, readings, {}


def _tolerated() -> Iterator[tuple[str, str, Image, list[dict[str, Any]], dict[str, Any]]]:
    image = Image().publish(1, 2)
    for index in range(4):
        image.line(
            index,
            claim=0x1000 + index,
            beat=5,
            beat_ms=100,
            taken=2,
            lost=index,
            retries=1,
            error=112,
            pid=99,
        )
        image.data[240 + 64 * index : 248 + 64 * index] = b"RosTask" + b"\0"
    image.set(refused=3, truncated=4, writer_error=115, writer_pid=4712)
    yield "claimed-lines", "every line is claimed", image, [reading(image, "newest", 1, (2, 0))], {}

    image = Image(description={"topic": "/latched", "bridge": "map"}).publish(1)
    readings = [reading(image, "newest", 0, (1, 0)), reading(image, "newest", 1)]
    yield "latched", "one message long ago; only a latched topic's reader begins with it", image, readings, {}

    image = Image().publish(1, 2).set(version=0x00010007, features_optional=0xFFFFFFFF)
    yield (
        "minor-version",
        "an unknown minor version and unknown optional features",
        image,
        [reading(image, "newest", 1, (2, 0))],
        {},
    )

    image = Image().publish(1, 2)
    image.data[112:128] = b"\xee" * 16
    image.data[168:192] = b"\xee" * 24
    image.data[448:512] = b"\xee" * 64
    for slot in range(4):
        at = image.slots_offset + slot * image.stride
        image.data[at + 56 : at + 64] = b"\xee" * 8
        image.data[at + 28 : at + 32] = b"\xee" * 4
    yield (
        "reserved-words",
        "reserved words are used by a later version",
        image,
        [reading(image, "newest", 1, (2, 0))],
        {},
    )

    image = Image(
        description={"bridge": "Zelle Süd 7 — 東", "definition": "# Größe in µm\nuint32 größe\n"}
    ).publish(1, 2)
    yield (
        "unicode",
        "text beyond ASCII in the self-description",
        image,
        [reading(image, "newest", 1, (2, 0))],
        {},
    )

    image = Image(description={"later": {"member": [1, 2, None]}}).publish(1, 2)
    yield (
        "unknown-members",
        "a later version's members in the self-description",
        image,
        [reading(image, "newest", 1, (2, 0))],
        {},
    )
