"""Values in .msg text."""

from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from rosplc.model import ArrayType, FieldType, NamedType, PrimitiveType, SequenceType, StringType
from rosplc.model.parse import INTEGER_RANGES, LiteralError, format_value, parse_value, strip_comment
from rosplc.model.types import ROS1_BYTE, Value

INT32 = PrimitiveType("int32")
STRING = StringType()


@pytest.mark.parametrize(
    ("text", "kind", "value"),
    [
        ("1", INT32, 1),
        ("-0x10", INT32, -16),
        ("0b101", INT32, 5),
        ("0o17", INT32, 15),
        ("010", INT32, 10),
        ("true", PrimitiveType("bool"), True),
        ("False", PrimitiveType("bool"), False),
        ("0", PrimitiveType("bool"), False),
        ("1", PrimitiveType("float64"), 1.0),
        ("-.5e-3", PrimitiveType("float64"), -0.0005),
        ("-1", PrimitiveType("byte"), 255),
        ("-1", ROS1_BYTE, -1),
        ("200", ROS1_BYTE, -56),
        ("1_000", INT32, 1000),
        ("0xff_ff", INT32, 65535),
        ("1_0.2_5e1_0", PrimitiveType("float64"), 10.25e10),
        ("plain text", STRING, "plain text"),
        ('"a # b"', STRING, "a # b"),
        (r"'it\'s'", STRING, "it's"),
        (r'"\\n is \n"', STRING, "\\n is \n"),
        ('""', STRING, ""),
        ("[]", SequenceType(INT32), ()),
        ("[ 1,2 , -3 ]", ArrayType(INT32, 3), (1, 2, -3)),
        ("""["a, b", 'c]', d e]""", SequenceType(STRING), ("a, b", "c]", "d e")),
        ("[true, false]", ArrayType(PrimitiveType("bool"), 2), (True, False)),
    ],
)
def test_literals_are_read_as_their_type(text: str, kind: FieldType, value: Value) -> None:
    """A literal takes the value and the Python type that its field has."""
    assert parse_value(text, kind) == value
    assert type(parse_value(text, kind)) is type(value)


@pytest.mark.parametrize(
    ("text", "kind", "reason"),
    [
        ("1.5", INT32, "whole number"),
        ("2147483648", INT32, "outside the range of int32"),
        ("256", PrimitiveType("uint8"), "outside the range of uint8"),
        ("-129", PrimitiveType("byte"), "outside the range of byte"),
        ("yes", PrimitiveType("bool"), "neither true nor false"),
        ("1.2.3", PrimitiveType("float64"), "not a number"),
        ("1e39", PrimitiveType("float32"), "outside the range of float32"),
        ('"open', STRING, "quotation mark"),
        ('"a" b', STRING, "quotation mark"),
        ("a\0b", STRING, "NUL"),
        ("'äöü'", StringType(5), "longer than 5 bytes"),
        ("1", SequenceType(INT32), "array literal"),
        ("[1, 2]", ArrayType(INT32, 3), "2 values"),
        ("[1, 2]", SequenceType(INT32, 1), "at most 1"),
        ("[1,,2]", SequenceType(INT32), "whole number"),
        ("[1,]", SequenceType(INT32), "whole number"),
        ("1__0", INT32, "whole number"),
        ("1_", INT32, "whole number"),
        ("_1", INT32, "whole number"),
        ("1_.5", PrimitiveType("float64"), "not a number"),
        ("1", NamedType("a/msg/B"), "cannot have a default"),
        ("[]", SequenceType(NamedType("a/msg/B")), "cannot have a default"),
    ],
)
def test_bad_literals_say_why(text: str, kind: FieldType, reason: str) -> None:
    """A literal that is not of its type is refused with the reason."""
    with pytest.raises(LiteralError, match=reason):
        parse_value(text, kind)


@pytest.mark.parametrize(
    ("line", "text"),
    [
        ("1 # one", "1"),
        ("'a # b' # c", "'a # b'"),
        ("[\"#\", '#'] # c", "[\"#\", '#']"),
        ("it's # not quoted", "it's"),
        ("# all", ""),
    ],
)
def test_comments_end_a_literal_outside_of_quotes(line: str, text: str) -> None:
    """A hash sign starts a comment only where it is not within quotation marks."""
    assert strip_comment(line) == text


TEXTS = st.text(st.characters(blacklist_categories=("Cs",), blacklist_characters="\0"), max_size=20)


@given(st.lists(TEXTS, max_size=4))
def test_strings_survive_writing_and_reading(texts: list[str]) -> None:
    """Every text without NUL can be written as a default value and read back."""
    value = tuple(texts)
    assert parse_value(format_value(value), SequenceType(STRING)) == value
    line = f"{format_value(value)} # comment"
    if "\n" not in line:
        assert parse_value(strip_comment(line), SequenceType(STRING)) == value


@given(st.data())
def test_numbers_survive_writing_and_reading(data: st.DataObject) -> None:
    """Every number of every type can be written and read back."""
    name, (low, high) = data.draw(st.sampled_from(sorted(INTEGER_RANGES.items())))
    number = data.draw(st.integers(low, high))
    assert parse_value(format_value(number), PrimitiveType(name)) == number
    real = data.draw(st.floats(allow_nan=True))
    back = parse_value(format_value(real), PrimitiveType("float64"))
    assert back == real or (math.isnan(real) and isinstance(back, float) and math.isnan(back))
