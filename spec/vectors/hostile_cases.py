"""Objects that must be refused, with the number of section 9, or read without harm."""

from __future__ import annotations

import json
from collections.abc import Iterator
from typing import Any

from region_cases import TOP, reading
from region_image import Image

__all__ = ["images", "scribbled"]

Case = tuple[str, str, Image, dict[str, Any]]


def _refused(
    name: str, error: int, about: str, *, expect: dict[str, Any] | None = None, **words: int
) -> Case:
    return name, about, Image().publish(1, 2).set(**words), {"error": error, "expect": expect or {}}


def images() -> Iterator[Case]:
    """Yield name, what it is about, image, and the members that say what must happen."""
    for size in (0, 1, 127, 511):
        yield f"size-{size}", f"a file of {size} bytes", Image(), {"error": 103, "expect": {}, "size": size}
    for name, magic in (("zero", 0), ("byte-order", 0x52504C43), ("one-bit", 0x434C5053)):
        yield _refused(f"magic-{name}", 104, "another program's object", magic=magic)
    for name, version in (("zero", 0), ("major-0", 0xFFFF), ("major-2", 0x20000), ("major-65535", TOP)):
        yield _refused(f"version-{name}", 105, "another major version", version=version)
    for name, bits in (("lowest", 1), ("highest", 1 << 31), ("all", TOP)):
        yield _refused(
            f"features-required-{name}", 106, "a feature that nobody knows", features_required=bits
        )
    yield _refused("crc-zero", 107, "no CRC", identity_crc=0)
    image = Image().publish(1, 2)
    image.data[80] ^= 1
    yield "crc-one-bit", "one bit of the bridge id flipped", image, {"error": 107, "expect": {}}
    image = Image().publish(1, 2)
    image.data[36:40] = (image.stride * 2).to_bytes(4, "little")
    yield "crc-geometry", "a stride that the CRC does not vouch for", image, {"error": 107, "expect": {}}
    yield from _fixed_sizes()
    yield from _geometry()
    yield from _after_geometry()
    yield from _order()
    yield from _descriptions()


def _fixed_sizes() -> Iterator[Case]:
    for value in (0, 448, 576, TOP):
        yield _refused(f"header-size-{value}", 108, "header_size is 512 in version 1", header_size=value)
    for value in (0, 32, 128, TOP):
        yield _refused(f"slot-header-size-{value}", 108, "slot_header_size is 64", slot_header_size=value)
    for value in (0, 3, 5, TOP):
        yield _refused(f"reader-lines-{value}", 108, "reader_lines is 4 in version 1", reader_lines=value)
    for value in (0, 3, TOP):
        yield _refused(f"state-{value}", 108, "state is LIVE or RETIRED, nothing else", state=value)
    yield _refused("generation-0", 108, "generation is never 0", generation=0)


def _geometry() -> Iterator[Case]:
    for value in (0, 1, 2, 3, 5, 6, 12, 65535, 65537, 131072, 1 << 31, TOP):
        yield _refused(
            f"slot-count-{value}", 108, "slot_count is a power of two, 4 to 65536", slot_count=value
        )
    for value in (0, 64, 127, 129, 192 - 1, TOP, TOP - 63):
        yield _refused(
            f"slot-stride-{value}", 108, "slot_stride: a multiple of 64 that holds a slot", slot_stride=value
        )
    yield _refused(
        "slot-stride-below-record", 108, "a record that reaches into the next slot", record_size=65
    )
    for value in (0, 2**30 + 1, 1 << 31, TOP, TOP - 62):
        yield _refused(
            f"record-size-{value}", 108, "record_size is 1 to 2^30; plus 64 it may wrap", record_size=value
        )
    at = Image().slots_offset
    for value in (0, 64, 512, at - 64, at + 1, at + 32, TOP, TOP - 63, 1 << 31):
        yield _refused(
            f"slots-offset-{value}", 108, "slots_offset: a multiple of 64 after the text", slots_offset=value
        )
    for value in (0, 128, 511, TOP, TOP - 100):
        yield _refused(
            f"description-offset-{value}",
            108,
            "the text begins after the header, and ends before the slots",
            description_offset=value,
        )
    for value in (0, 1, 2**20 + 1, 1 << 31, TOP, TOP - 511):
        yield _refused(
            f"description-size-{value}", 108, "the text has 2 to 2^20 bytes", description_size=value
        )
    size = len(Image().data)
    for value in (0, 512, size - 64, size - 1, 1 << 31, TOP):
        yield _refused(
            f"object-size-{value}", 108, "object_size holds all slots, at most 2^31 - 1", object_size=value
        )
    yield _refused("geometry-stride-overflow", 108, "4 × 2^30 wraps to 0 in 32 bits", slot_stride=1 << 30)
    yield _refused(
        "geometry-count-overflow", 108, "65536 × 65536 wraps to 0", slot_count=65536, slot_stride=65536
    )
    yield _refused(
        "geometry-sum-overflow",
        108,
        "slots_offset + slots wraps to something small",
        slots_offset=0xFFFFFC00,
        slot_count=4,
        slot_stride=448,
    )
    yield _refused(
        "geometry-description-overflow",
        108,
        "description_offset + description_size wraps",
        description_offset=0xFFFFFF00,
        description_size=0x300,
    )
    yield _refused(
        "geometry-record-overflow", 108, "slot_header_size + record_size wraps to 63", record_size=TOP
    )
    yield _refused(
        "geometry-everything-is-max",
        108,
        "every size is the largest number",
        slot_count=TOP,
        slot_stride=TOP,
        record_size=TOP,
        slots_offset=TOP,
        object_size=TOP,
        description_offset=TOP,
        description_size=TOP,
    )
    yield _refused("geometry-slots-over-object", 108, "twice as many slots as the object holds", slot_count=8)


def _after_geometry() -> Iterator[Case]:
    size = len(Image().data)
    for name, cut in (("one-byte", 1), ("half", size // 2)):
        image = Image().publish(1, 2)
        yield (
            f"truncated-{name}",
            "somebody made the file smaller",
            image,
            {"error": 109, "expect": {}, "size": size - cut},
        )
    name, about, image, members = _refused(
        "huge-object", 109, "an object that says 2^31 - 1 bytes", object_size=2**31 - 1
    )
    yield name, about, image, members
    for value in (0, 2, 3, TOP):
        yield _refused(f"kind-{value}", 110, "kinds 2 and 3 are reserved, others do not exist", kind=value)
    for value in (0, 3, TOP):
        yield _refused(f"direction-{value}", 110, "no such direction", direction=value)
    yield _refused("direction-other", 110, "the topic goes the other way", expect={"direction": 2})
    yield _refused("retired", 111, "a retired object", state=2)
    yield _refused("layout-id-other", 112, "another layout", expect={"layout_id": "0123456789abcdee"})
    yield _refused(
        "layout-id-swapped", 112, "the layout id's words swapped", expect={"layout_id": "89abcdef01234567"}
    )
    yield _refused("record-size-other", 112, "another record size", expect={"record_size": 16})


def _order() -> Iterator[Case]:
    yield _refused(
        "order-magic-first",
        104,
        "everything is wrong: magic is looked at first",
        magic=1,
        version=0,
        features_required=1,
        identity_crc=0,
        state=7,
        kind=9,
    )
    yield _refused(
        "order-version-before-features",
        105,
        "version before features",
        version=0x20000,
        features_required=1,
        identity_crc=0,
    )
    yield _refused(
        "order-features-before-crc", 106, "features before the CRC", features_required=1, identity_crc=0
    )
    yield _refused(
        "order-crc-before-geometry", 107, "the CRC before the geometry", identity_crc=0, slot_count=0
    )
    yield _refused(
        "order-geometry-before-kind", 108, "geometry before kind and state", slot_count=0, kind=9, state=2
    )
    yield _refused("order-kind-before-state", 110, "kind before state", kind=2, state=2)
    yield _refused(
        "order-state-before-layout",
        111,
        "state before layout",
        state=2,
        expect={"layout_id": "0000000000000000"},
    )
    name, about, image, members = _refused("order-size-before-kind", 109, "size before kind", kind=2)
    yield name, about, image, {**members, "size": len(image.data) - 1}


def _descriptions() -> Iterator[Case]:
    usual = Image().description
    texts: dict[str, bytes] = {
        "not-json": b"{]",
        "not-utf8": b'{"topic": "\xff\xfe"}',
        "byte-order-mark": b"\xef\xbb\xbf" + json.dumps(usual).encode(),
        "array": b"[]",
        "nested": b"[" * 200_000,
        "cut-off": json.dumps(usual).encode()[:-1],
        "zeros": bytes(64),
        "format-2": json.dumps({**usual, "format": "rosplc 2.0"}).encode(),
        "direction-unknown": json.dumps({**usual, "direction": "sideways"}).encode(),
        "layout-id-short": json.dumps({**usual, "layout_id": "0123"}).encode(),
        "limits-a-list": json.dumps({**usual, "limits": [80, 16]}).encode(),
        "topic-a-number": json.dumps({**usual, "topic": 7}).encode(),
    }
    for member in usual:
        rest = {key: value for key, value in usual.items() if key != member}
        texts[f"without-{member.replace('_', '-')}"] = json.dumps(rest).encode()
    for name, text in texts.items():
        image = Image(text=text).publish(1, 2)
        members = {"error": 113, "expect": {}, "still_readable": True}
        yield (
            f"description-{name}",
            "tools refuse the text; messages can be read all the same",
            image,
            members,
        )


def scribbled() -> Iterator[tuple[str, str, Image, list[dict[str, Any]]]]:
    """Yield objects that open, and whose head or slots somebody has written over."""

    def ring() -> Image:
        return Image().publish(6, 7, 8, 9)

    def nothing(image: Image, *lasts: int) -> list[dict[str, Any]]:
        return [reading(image, order, last) for last in lasts for order in ("newest", "in_order")]

    for name, head, lasts in (
        ("zero", 0, (9, 5)),
        ("one-ahead", 10, (9,)),
        ("far-ahead", 1000, (9, 6)),
        ("half-way", 9 + 2**31, (9, 6)),
        ("largest", TOP, (9, 6)),
        ("skipped-by-the-wrap", 3, (9, 6)),
        ("one-behind", 8, (9,)),
        ("three-behind", 6, (9,)),
        ("four-behind", 5, (9,)),
        ("far-behind", 1, (9,)),
    ):
        image = ring().set(head=head)
        yield f"head-{name}", f"head is {head}, the newest message 9", image, nothing(image, *lasts)
    image = ring().set(head=3).slot(3, sequence=3)
    about = "head is 3, which the wrap skips and its slot confirms: no message behind 4294967295"
    yield "head-confirmed-behind-the-wrap", about, image, nothing(image, TOP)
    for name, words in (
        ("sealed", {"sequence": 0}),
        ("old", {"sequence": 5}),
        ("next-lap", {"sequence": 13}),
        ("random", {"sequence": 0xDEADBEEF}),
        ("length-short", {"length": 11}),
        ("length-long", {"length": 13}),
        ("length-zero", {"length": 0}),
        ("length-largest", {"length": TOP}),
    ):
        image = ring().slot(1, **words)
        yield (
            f"newest-slot-{name}",
            "the slot that head names is not what it must be",
            image,
            nothing(image, 8),
        )
        image = ring().slot(0, **words)
        if name == "old":
            image.slot(0, sequence=4)
        readings = [reading(image, "newest", 7, (9, 1)), reading(image, "in_order", 7, (9, 1))]
        about = "one slot in the middle is not what it must be: on at head (M13)"
        yield f"middle-slot-{name}", about, image, readings
    image = ring()
    image.data[image.slots_offset :] = b"\xff" * (len(image.data) - image.slots_offset)
    yield "slots-all-ones", "every byte of every slot is 255", image, nothing(image, 8, 5, 0)
    image = ring()
    image.data[128:512] = b"\xff" * 384
    yield "control-all-ones", "every control word is 2^32 - 1", image, nothing(image, 9)
    image = ring()
    image.set(writer_beat_ms=TOP, writer_epoch=TOP, refused=TOP, sources=TOP, writer_rule=TOP)
    yield (
        "writer-line-largest",
        "the writer's line is full of nonsense, but head",
        image,
        [reading(image, "newest", 8, (9, 0))],
    )
