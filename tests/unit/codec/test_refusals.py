"""Exact refusal codes, sizes and limits, one wire feature per row."""

from __future__ import annotations

import struct

import pytest

from rosplc._core import Fault
from rosplc.codec import TRUNCATED, Codec, Wire
from rosplc.errors import CodecError
from rosplc.layout import Limits, compute_layout
from rosplc.model import TypeStore
from tests.codec_types import hard_store

JAZZY = TypeStore.bundled("jazzy")
LITTLE, BIG = b"\0\1\0\0", b"\0\0\0\0"
NO_OP = 0xFFFFFFFF


def codec(text: str, wire: Wire = Wire.CDR, string: int = 4, sequence: int = 2) -> Codec:
    store = hard_store("jazzy").with_definition("test_msgs/msg/T", text.replace(";", "\n") + "\n")
    return Codec(compute_layout(store, "test_msgs/msg/T", Limits(string, sequence)), wire)


def word(*values: int) -> bytes:
    return struct.pack(f"<{len(values)}I", *values)


# definition, message, truncate, (code, size, limit), path
CDR_REFUSALS = [
    ("uint32 a", b"", False, (1, 4, 0), ""),
    ("uint32 a", b"\0\1\0", False, (1, 4, 3), ""),
    ("uint32 a", LITTLE, False, (1, 8, 4), "a"),
    ("uint32 a", LITTLE + b"123", False, (1, 8, 7), "a"),
    ("uint8 a;uint64 b", LITTLE + bytes(8), False, (1, 20, 12), "b"),
    ("uint32 a", LITTLE + bytes(8), False, (2, 12, 11), ""),
    ("uint32 a", b"\0\2\0\0" + bytes(4), False, (3, 0x0002, 0), ""),
    ("uint32 a", b"\0\3\0\0" + bytes(4), False, (3, 0x0003, 0), ""),
    ("uint32 a", b"\0\7\0\0" + bytes(4), False, (3, 0x0007, 0), ""),
    ("uint32 a", b"\1\1\0\0" + bytes(4), False, (3, 0x0101, 0), ""),
    ("string a", LITTLE + word(6) + b"12345\0", False, (4, 5, 4), "a"),
    ("string a", LITTLE + word(0xFFFFFFFF) + b"1234\0", True, (1, 8 + 0xFFFFFFFF, 13), "a"),
    ("string a", LITTLE + word(4) + b"1234", True, (7, 4, 3), "a"),
    ("string a", LITTLE + word(5) + b"1\0" + b"34\0", False, (7, 5, 1), "a"),
    ("string<=3 a", LITTLE + word(5) + b"1234\0", True, (4, 4, 3), "a"),
    ("string<=9 a", LITTLE + word(6) + b"12345\0", False, (4, 5, 4), "a"),
    ("bool a", LITTLE + b"\2", False, (6, 2, 1), "a"),
    ("bool[3] a", LITTLE + b"\1\0\x80", False, (6, 0x80, 1), "a"),
    ("uint8 x;bool a;bool b", LITTLE + b"\xff\1\xff", True, (6, 255, 1), "b"),
    ("bool[] a", LITTLE + word(2) + b"\1\2", False, (6, 2, 1), "a"),
    ("uint16[] a", LITTLE + word(3) + bytes(6), False, (5, 3, 2), "a"),
    ("uint16[<=3] a", LITTLE + word(3) + bytes(6), False, (5, 3, 2), "a"),
    ("uint16[<=2] a", LITTLE + word(3) + bytes(6), True, (8, 3, 2), "a"),
    ("uint16[] a", LITTLE + word(0xFFFFFFFF) + bytes(6), True, (1, 8 + 2 * 0xFFFFFFFF, 14), "a"),
    ("float64[] a", LITTLE + word(1) + bytes(8), False, (1, 20, 16), "a"),
    ("string[] a", LITTLE + word(3) + word(0, 0, 0), False, (5, 3, 2), "a"),
    ("string[<=2] a", LITTLE + word(3) + word(0, 0, 0), True, (8, 3, 2), "a"),
    ("string[] a", LITTLE + word(2) + word(0, 6) + b"12345\0", False, (4, 5, 4), "a[]"),
    ("string[] a", LITTLE + word(0x40000000) + word(0, 0), True, (1, 8 + 2**32, 16), "a"),
    ("hard_msgs/Leaf[2] a", LITTLE + bytes(20) + word(3) + bytes(12), False, (5, 3, 2), "a[].values"),
    ("hard_msgs/Nothing[] a", LITTLE + word(0xFFFFFFFF) + bytes(4), True, (1, 8 + 0xFFFFFFFF, 12), "a"),
    ("", LITTLE, False, (1, 5, 4), ""),
    ("string[] a", BIG + bytes([0, 0, 0, 3]) + bytes(12), False, (5, 3, 2), "a"),
    ("string a", BIG + bytes([0, 0, 0, 4]) + b"1234", True, (7, 4, 3), "a"),
    ("uint64 a", BIG + bytes(7), False, (1, 12, 11), "a"),
]

ROS1_REFUSALS = [
    ("uint32 a", b"", False, (1, 4, 0), "a"),
    ("uint32 a", bytes(5), False, (2, 5, 4), ""),
    ("", b"\0", True, (2, 1, 0), ""),
    ("string a", word(5) + b"12345", False, (4, 5, 4), "a"),
    ("string a", word(5) + b"1234", True, (1, 9, 8), "a"),
    ("string a", word(4) + b"123\0", False, (7, 4, 3), "a"),
    ("bool[] a", word(1) + b"\2", False, (6, 2, 1), "a"),
    ("float64[] a", word(3) + bytes(24), False, (5, 3, 2), "a"),
    ("float64[] a", word(0xFFFFFFFF) + bytes(24), True, (1, 4 + 8 * 0xFFFFFFFF, 28), "a"),
    ("hard_msgs/Nothing[] a", word(0xFFFFFFFF), False, (5, 0xFFFFFFFF, 2), "a"),
    ("hard_msgs/HeavyNothing[] a", word(0xFFFFFFFF) + bytes(9), True, (1, 4 + 0xFFFFFFFF, 13), "a"),
]


@pytest.mark.parametrize(
    ("wire", "text", "message", "truncate", "numbers", "path"),
    [(Wire.CDR, *row) for row in CDR_REFUSALS] + [(Wire.ROS1, *row) for row in ROS1_REFUSALS],
)
def test_refusal(
    wire: Wire, text: str, message: bytes, truncate: bool, numbers: tuple[int, int, int], path: str
) -> None:
    """Each kind of damage has its code, and names field, size and limit."""
    tested = codec(text, wire)
    with pytest.raises(Fault) as fault:
        tested.plan.decode(message, truncate)
    code, op, size, limit = fault.value.args
    assert (code, size, limit) == numbers
    assert (op == NO_OP) == (path == "" and text != "") or text == ""
    with pytest.raises(CodecError) as error:
        tested.decode(message, truncate=truncate)
    assert error.value.code == f"COD{code:03d}"
    assert error.value.where == (f"test_msgs/msg/T: {path}" if path else "test_msgs/msg/T")


# definition, message, record, flags
ACCEPTED = [
    (Wire.CDR, "string a", LITTLE + word(0), b"\0" * 5, 0),
    (Wire.CDR, "string a", LITTLE + word(1) + b"\0\0\0\0", b"\0" * 5, 0),
    (Wire.CDR, "string a", LITTLE + word(5) + b"1234\0", b"1234\0", 0),
    (Wire.CDR, "string a", LITTLE + word(6) + b"12345\0", b"1234\0", TRUNCATED),
    (Wire.CDR, "string a", LITTLE + word(7) + "123€".encode() + b"\0", b"123\0\0", TRUNCATED),
    (Wire.CDR, "string a", LITTLE + word(5) + "€x".encode() + b"\0", "€x".encode() + b"\0", 0),
    (Wire.CDR, "string a", LITTLE + word(6) + "€é".encode() + b"\0", "€".encode() + b"\0\0", TRUNCATED),
    (Wire.CDR, "string a", LITTLE + word(7) + b"\x80" * 6 + b"\0", b"\x80" * 4 + b"\0", TRUNCATED),
    (Wire.CDR, "string a", LITTLE + word(5) + b"1\0" + b"34\0", b"1\0\0\0\0", TRUNCATED),
    (Wire.CDR, "bool a;bool b", LITTLE + b"\0\1", b"\0\1", 0),
    (Wire.CDR, "uint16[] a", LITTLE + word(3) + b"abcdef", word(2) + b"abcd", TRUNCATED),
    (Wire.CDR, "uint16[] a", LITTLE + word(1) + b"ab", word(1) + b"ab\0\0", 0),
    (Wire.CDR, "float64[] a", LITTLE + word(0), word(0, 0) + bytes(16), 0),
    (Wire.CDR, "string[] a", LITTLE + word(3, 2) + b"a\0..\2\0\0\0b\0..\2\0\0\0c\0",
     word(2) + b"a\0\0\0\0b\0\0\0\0\0\0", TRUNCATED),
    (Wire.CDR, "uint8 a", b"\0\1\xab\xcd" + b"\7...", b"\7", 0),
    (Wire.CDR, "uint16 a", BIG + b"\1\2", b"\2\1", 0),
    (Wire.CDR, "", LITTLE + b"\7", b"\0", 0),
    (Wire.ROS1, "", b"", b"\0", 0),
    (Wire.ROS1, "string a", word(4) + b"1234", b"1234\0", 0),
    (Wire.ROS1, "string a", word(3) + b"12\0", b"12\0\0\0", TRUNCATED),
    (Wire.ROS1, "uint8 a;float64[] b", b"\7" + word(1) + b"12345678",
     b"\7\0\0\0" + word(1) + b"12345678" + bytes(8), 0),
    (Wire.ROS1, "hard_msgs/Nothing[] a", word(0xFFFFFFFF), word(2) + bytes(4), TRUNCATED),
    (Wire.ROS1, "hard_msgs/HeavyNothing[] a;uint8 b", word(3) + b"abc" + b"d",
     word(2) + b"a" + bytes(100) + b"b" + bytes(100) + b"d\0", TRUNCATED),
]  # fmt: skip


@pytest.mark.parametrize(("wire", "text", "message", "record", "flags"), ACCEPTED)
def test_acceptance(wire: Wire, text: str, message: bytes, record: bytes, flags: int) -> None:
    """What is allowed on the wire gives exactly this record; only `truncate` cuts, and says so."""
    tested = codec(text, wire)
    out = bytearray(b"\xaa" * len(record))
    assert tested.decode_into(message, out, truncate=True) == flags
    assert out == record
    if flags:
        with pytest.raises(CodecError):
            tested.decode(message)
    else:
        assert tested.decode(message) == record


# definition, record, message
ENCODED = [
    (Wire.CDR, "string a", b"1234x", LITTLE + word(5) + b"1234\0\0\0\0"),
    (Wire.CDR, "string a", b"1\0zzz", LITTLE + word(2) + b"1\0\0\0"),
    (Wire.CDR, "bool a;bool[2] b", b"\2\0\xff", LITTLE + b"\1\0\1\0"),
    (Wire.CDR, "bool[] a", word(2) + b"\x80\0\0\0", LITTLE + word(2) + b"\1\0\0\0"),
    (Wire.CDR, "uint16[] a", word(0xFFFFFFFF) + b"abcd", LITTLE + word(2) + b"abcd"),
    (Wire.CDR, "uint8 a;uint32 b", b"\1zzz" + word(2), LITTLE + b"\1\0\0\0" + word(2)),
    (Wire.CDR, "float64[] a;uint8 b", word(0) + b"z" * 20 + b"\7" + b"z" * 7, LITTLE + word(0) + b"\7\0\0\0"),
    (Wire.CDR, "", b"\7", LITTLE + bytes(4)),
    (Wire.ROS1, "", b"\7", b""),
    (
        Wire.ROS1,
        "uint8 a;uint32 b;string c",
        b"\1zzz" + word(2) + b"ab\0zz\0\0\0",
        b"\1" + word(2, 2) + b"ab",
    ),
    (Wire.ROS1, "hard_msgs/Nothing[] a", word(9) + b"zzzz", word(2)),
]


@pytest.mark.parametrize(("wire", "text", "record", "message"), ENCODED)
def test_encoding_what_only_a_plc_writes(wire: Wire, text: str, record: bytes, message: bytes) -> None:
    """Counts are clamped, strings end at their capacity, bools become 0 or 1, unused bytes stay behind."""
    assert codec(text, wire).encode(record) == message


def test_truncation_passes_over_what_does_not_fit() -> None:
    """Elements beyond the capacity are checked like the others, but not stored, nested ones too."""
    tested = codec("hard_msgs/Leaf[] a;uint8 end", string=80, sequence=1)
    leaf = b"\1..." + word(3) + b"ab\0." + word(2) + word(7, 8)
    message = LITTLE + word(3) + leaf * 3 + b"\x2a"
    out = bytearray(tested.layout.size)
    assert tested.decode_into(message, out, truncate=True) == TRUNCATED
    view = tested.layout.to_dict(out)
    assert len(view["a"]) == 1
    assert view["a"][0]["name"] == "ab"
    assert len(view["a"][0]["values"]) == 1
    assert view["end"] == 0x2A
    broken = LITTLE + word(3) + leaf * 2 + b"\1..." + word(3) + b"abc." + word(2) + word(7, 8) + b"\x2a"
    with pytest.raises(CodecError) as error:
        tested.decode(broken, truncate=True)
    assert error.value.code == "COD007"
