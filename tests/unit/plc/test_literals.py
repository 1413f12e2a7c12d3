"""Values as Structured Text: each literal is read back by the rules of the language."""

from __future__ import annotations

import math
import re
import struct

import pytest

from rosplc.plc.names import literal, string_literal, time_literal

REAL = re.compile(r"-?\d+\.\d+(?:E[+-]?\d+)?\Z")


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("", "''"),
        ("plain text", "'plain text'"),
        ("it's", "'it$'s'"),
        ("5 $", "'5 $$'"),
        ("a\nb\rc\td\fe", "'a$Nb$Rc$Td$Pe'"),
        ("\x00\x1f\x7f", "'$00$1F$7F'"),
        ("ä€", "'$C3$A4$E2$82$AC'"),
        ("\U0001f600", "'$F0$9F$98$80'"),
    ],
)
def test_a_string_is_escaped(text, expected):
    """Quotes, dollars, control characters and UTF-8 bytes are written with ``$``."""
    assert string_literal(text) == expected


@pytest.mark.parametrize(
    ("value", "expected"),
    [
        (0.0, "0.0"),
        (-0.0, "-0.0"),
        (1, "1.0"),
        (1e22, "1.0E22"),
        (1e-5, "1.0E-5"),
        (-1.5e300, "-1.5E300"),
        (5e-324, "5.0E-324"),
        (1.7976931348623157e308, "1.7976931348623157E308"),
    ],
)
def test_a_floating_point_number_has_point_and_plain_exponent(value, expected):
    """A number always has a decimal point, so that it is none of the integer types."""
    assert literal("float64", value) == expected
    assert REAL.match(expected)


@pytest.mark.parametrize("bits", [0x00000001, 0x007FFFFF, 0x00800000, 0x3DCCCCCD, 0x7F7FFFFF, 0xFF7FFFFF])
def test_a_float32_keeps_its_bits(bits):
    """The literal of a float32 is read as the same float32."""
    value = struct.unpack("<f", struct.pack("<I", bits))[0]
    text = literal("float32", value)
    assert REAL.match(text)
    assert struct.pack("<f", float(text)) == struct.pack("<I", bits)


@pytest.mark.parametrize("value", [math.inf, -math.inf, math.nan])
def test_what_has_no_literal_gives_none(value):
    """Structured Text cannot write infinity and NaN."""
    assert literal("float64", value) is None
    assert literal("float64", [1.0, value]) is None


@pytest.mark.parametrize(
    ("kind", "value", "expected"),
    [
        ("bool", True, "TRUE"),
        ("bool", 0, "FALSE"),
        ("uint8", 255, "255"),
        ("int32", -(2**31), "-2147483648"),
        ("uint32", 2**32 - 1, "4294967295"),
        ("int64", 2**63 - 1, "9223372036854775807"),
        ("uint64", 2**63 - 1, "9223372036854775807"),
        ("uint64", 2**64 - 1, "ULINT#18446744073709551615"),
        ("string", "x", "'x'"),
    ],
)
def test_an_elementary_value(kind, value, expected):
    """Integers are plain numbers as far as every compiler reads them alike."""
    assert literal(kind, value) == expected


def test_the_smallest_int64_is_written_without_a_number_too_large():
    """The digits of -2^63 without their sign fit no signed type, so it is a difference."""
    text = literal("int64", -(2**63))
    assert all(int(digits) < 2**63 for digits in re.findall(r"\d+", text))
    assert sum(int(part) for part in text.replace("- 1", "-1").split()) == -(2**63)


def test_a_list_becomes_an_array_initialiser():
    """Arrays are in brackets; an empty one has no initialiser."""
    assert literal("int8", [1, -2]) == "[1, -2]"
    assert literal("string", ("a", "b,c")) == "['a', 'b,c']"
    assert literal("int8", []) is None


@pytest.mark.parametrize(
    ("nanoseconds", "expected"),
    [(0, "T#0ms"), (1, "T#1ms"), (1_000_000, "T#1ms"), (1_000_001, "T#2ms"), (10**18, "T#4294967295ms")],
)
def test_a_time_is_rounded_up_and_stays_within_the_type(nanoseconds, expected):
    """A limit is never shortened, and TIME ends after 49 days."""
    assert time_literal(nanoseconds) == expected
