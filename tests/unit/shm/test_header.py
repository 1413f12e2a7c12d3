"""The identity of an object, in Python and in C: spec/shm-format.md, sections 2 and 9."""

from __future__ import annotations

import re
import struct
import zlib
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from rosplc._core import check_identity, distance, next_sequence
from rosplc.errors import CODES, ChannelError
from rosplc.shm import Direction, Identity
from rosplc.shm.constants import HEADER_SIZE, IDENTITY, READER_LINE, SLOT_HEADER, WRITER_LINE, ErrorNumber
from rosplc.shm.header import layout_id_text, layout_id_words

ROOT = Path(__file__).resolve().parents[3]


def _identity(**changes: object) -> Identity:
    arguments = {
        "direction": Direction.TO_ROS,
        "slots": 4,
        "record_size": 200,
        "description_size": 100,
        "layout_id": "0123456789abcdef",
        "generation": 7,
        "bridge_id": bytes(range(16)),
    }
    return Identity.plan(**(arguments | changes))  # type: ignore[arg-type]


def _image(identity: Identity) -> bytes:
    return identity.build() + bytes(HEADER_SIZE - 128)


def _outcome(image: bytes, size: int, direction: Direction | None = None) -> int:
    """The number that parsing raises, 0 for none, the same in Python and in C."""
    try:
        Identity.parse(image, size, direction=direction)
        number = 0
    except ChannelError as error:
        number = int(error.code[3:])
    assert check_identity(image, size, direction or 0) == number
    return number


def _signed(image: bytes, word: str, value: int) -> bytes:
    at = IDENTITY[word]
    changed = image[:at] + struct.pack("<I", value) + image[at + 4 :]
    crc = zlib.crc32(changed[16:108], zlib.crc32(changed[:12]))
    return changed[:108] + struct.pack("<I", crc) + changed[112:]


def test_offsets_are_those_of_the_specification() -> None:
    """Every row of the specification's tables of words has the offset that the code uses."""
    text = (ROOT / "spec" / "shm-format.md").read_text(encoding="utf-8")
    for start, end, table in (
        ("## 2.", "## 3.", IDENTITY),
        ("## 3.", "## 4.", WRITER_LINE),
        ("## 4.", "## 5.", READER_LINE),
        ("## 5.", "## 6.", SLOT_HEADER),
    ):
        section = text[text.index(start) : text.index(end)]
        found: dict[str, int] = {}
        for offset, cell in re.findall(r"^\| \+?(\d+) \| ([^|]+) \|", section, re.MULTILINE):
            for place, name in enumerate(re.findall(r"[a-z_]+", re.sub(r"\[\d+\]", "", cell))):
                found[name] = int(offset) + 4 * place
        assert found == table


def test_index_lists_the_rules_in_reading_order() -> None:
    """The specification's index names each rule once, in the order and the section of its definition."""
    text = (ROOT / "spec" / "shm-format.md").read_text(encoding="utf-8")
    index, body = text[: text.index("## 1.")], text[text.index("## 1.") :]
    section, defined = "", []
    for line in body.splitlines():
        if heading := re.match(r"###? (\d+(?:\.\d+)?)", line):
            section = heading[1]
        defined += [(rule, section) for rule in re.findall(r"\*\*(M\d+)", line)]
    assert re.findall(r"^\| (M\d+) \| .* \| ([\d.]+) \|$", index, re.MULTILINE) == defined
    assert len({rule for rule, _ in defined}) == len(defined) == 30


def test_error_numbers_are_the_registered_codes() -> None:
    """Every number of section 9 has a code, and every code a number."""
    assert {f"SHM{number:d}" for number in ErrorNumber} == {code for code in CODES if code.startswith("SHM")}


def test_round_trip() -> None:
    """What was built is what is parsed."""
    identity = _identity(creator_pid=99, created_ns=1_700_000_000_123_456_789)
    assert Identity.parse(_image(identity), identity.object_size) == identity
    assert check_identity(_image(identity), identity.object_size, 2) == 0


def test_layout_id_words() -> None:
    """The id's digits are its bytes in order, its words little-endian."""
    assert layout_id_words("0123456789abcdef") == (0x67452301, 0xEFCDAB89)
    assert layout_id_text(0x67452301, 0xEFCDAB89) == "0123456789abcdef"


@pytest.mark.parametrize("text", ["", "0123", "0123456789abcdeg", "0123456789abcdef00", "01 23456789abcde"])
def test_layout_ids_that_are_none(text: str) -> None:
    """Anything but 16 hexadecimal digits is refused."""
    with pytest.raises(ValueError):
        layout_id_words(text)


@pytest.mark.parametrize(
    ("word", "value", "number"),
    [
        ("magic", 0, 104),
        ("version", 0x20000, 105),
        ("version", 0x10009, 0),
        ("features_required", 1, 106),
        ("features_optional", 0xFFFFFFFF, 0),
        ("header_size", 576, 108),
        ("state", 0, 108),
        ("state", 2, 111),
        ("state", 3, 108),
        ("kind", 2, 110),
        ("direction", 0, 110),
        ("direction", 3, 110),
        ("slot_count", 2, 108),
        ("slot_count", 6, 108),
        ("slot_count", 131072, 108),
        ("slot_count", 65536, 108),
        ("slot_stride", 0, 108),
        ("slot_stride", 256, 108),
        ("slot_stride", 321, 108),
        ("slot_stride", 0xFFFFFFC0, 108),
        ("slot_header_size", 128, 108),
        ("record_size", 0, 108),
        ("record_size", 0x40000001, 108),
        ("slots_offset", 0xFFFFFFC0, 108),
        ("slots_offset", 576, 108),
        ("slots_offset", 641, 108),
        ("object_size", 0, 108),
        ("object_size", 0x80000000, 108),
        ("object_size", 0x7FFFFFFF, 109),
        ("description_offset", 508, 108),
        ("description_offset", 0xFFFFFFFF, 108),
        ("description_size", 1, 108),
        ("description_size", 0x100001, 108),
        ("generation", 0, 108),
        ("reader_lines", 3, 108),
        ("creator_pid", 5, 0),
    ],
)
def test_hostile_words(word: str, value: int, number: int) -> None:
    """Each word that is wrong under a right CRC has its number, the same in both implementations."""
    identity = _identity()
    assert _outcome(_signed(_image(identity), word, value), identity.object_size) == number


def test_damage_and_size() -> None:
    """A flipped bit fails the CRC, a short file its size check, the other direction its own."""
    identity = _identity()
    image = _image(identity)
    flipped = image[:70] + bytes([image[70] ^ 1]) + image[71:]
    assert _outcome(flipped, identity.object_size) == 107
    assert _outcome(image, identity.object_size - 1) == 109
    assert _outcome(image, 511) == 103
    assert _outcome(image, identity.object_size, Direction.TO_PLC) == 110
    assert _outcome(image, identity.object_size + 5000, Direction.TO_ROS) == 0


@given(st.integers(0, 127), st.integers(0, 255), st.booleans(), st.integers(0, 2**33))
def test_any_byte(at: int, value: int, signed: bool, size: int) -> None:
    """For any byte changed and any size, both implementations give the same answer."""
    identity = _identity()
    image = bytearray(_image(identity))
    image[at] = value
    if signed:
        struct.pack_into("<I", image, 108, zlib.crc32(image[16:108], zlib.crc32(image[:12])))
    _outcome(bytes(image), size)


@given(st.binary(min_size=512, max_size=512), st.integers(0, 2**32))
def test_any_bytes(image: bytes, size: int) -> None:
    """Random bytes are refused alike."""
    _outcome(image, size)


@pytest.mark.parametrize(
    "changes",
    [
        {"slots": 3},
        {"slots": 2},
        {"slots": 2**17},
        {"record_size": 0},
        {"record_size": 2**30},
        {"record_size": 2**20, "slots": 4096},
        {"description_size": 2**20 + 1},
    ],
)
def test_plans_outside_the_format(changes: dict[str, int]) -> None:
    """No object is planned that an opener would refuse."""
    with pytest.raises(ValueError):
        _identity(**changes)


def test_parts_do_not_overlap() -> None:
    """Header, self-description and slots follow each other on lines of their own."""
    identity = _identity(description_size=65)
    assert identity.slots_offset == 640
    assert identity.slot_stride == 320
    assert identity.object_size == 640 + 4 * 320


def _slow_next(s: int, slots: int) -> int:
    return s + 1 if s < 2**32 - 1 else slots


@given(st.sampled_from([4, 8, 64, 65536]), st.integers(0, 200), st.integers(0, 400))
def test_distance_counts_messages(slots: int, before: int, steps: int) -> None:
    """Distance is the number of times that next leads from a to b, across the wrap too."""
    a = b = 2**32 - 1 - before
    for _ in range(steps):
        assert next_sequence(b, slots) == _slow_next(b, slots)
        b = next_sequence(b, slots)
    assert distance(a, b, slots) == steps
