"""Definition texts: what is understood, and what an error names."""

from __future__ import annotations

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from rosplc.errors import MessageTypeError
from rosplc.layout import compute_layout
from rosplc.model import ArrayType, NamedType, PrimitiveType, SequenceType, StringType, TypeStore
from rosplc.model.parse import MAX_FIELDS, MAX_TEXT, parse_definition
from rosplc.model.types import Constant, Field

SEPARATOR = "=" * 80 + "\n"


def test_every_form_of_a_field_is_understood() -> None:
    """Arrays, sequences, bounds, nested names and default values become the model's types."""
    text = """
        # A comment
        float64 x 1.5   # and another
        string<=10[<=5] names
        uint8[3] raw [1, 2, 3]
        other_msgs/Thing[] things
        other_msgs/msg/Thing thing
        Own[2] own
        Header header
        string  greeting  "hello # there"
        @optional int8 flag
        @key
        char\tc
    """
    (parsed,) = parse_definition("my_msgs/Test", text)
    thing = NamedType("other_msgs/msg/Thing")
    assert parsed.message.name == "my_msgs/msg/Test"
    assert parsed.message.fields == (
        Field("x", PrimitiveType("float64"), 1.5),
        Field("names", SequenceType(StringType(10), 5)),
        Field("raw", ArrayType(PrimitiveType("uint8"), 3), (1, 2, 3)),
        Field("things", SequenceType(thing)),
        Field("thing", thing),
        Field("own", ArrayType(NamedType("my_msgs/msg/Own"), 2)),
        Field("header", NamedType("std_msgs/msg/Header")),
        Field("greeting", StringType(), "hello # there"),
        Field("flag", PrimitiveType("int8")),
        Field("c", PrimitiveType("char")),
    )


def test_constants_are_kept_with_value_and_text() -> None:
    """A constant has the value of its type, and the text that ROS 1 hashes."""
    text = 'uint8 A=0x10\nfloat32 HALF = 0.50 # half\nstring S="x"\nint8 lower_case=-1\nbool B=True\n'
    (parsed,) = parse_definition("my_msgs/Test", text)
    constants = parsed.message.constants
    assert [(c.name, c.value, c.text) for c in constants] == [
        ("A", 16, "0x10"),
        ("HALF", 0.5, "0.50"),
        ("S", "x", '"x"'),
        ("lower_case", -1, "-1"),
        ("B", True, "True"),
    ]
    assert not parsed.message.fields


def test_string_constants_of_ros1_take_the_rest_of_the_line() -> None:
    """In ROS 1 neither quotes nor hash signs end a string constant."""
    (parsed,) = parse_definition("a/B", 'string S= "x" # no comment \n', ros_version=1)
    assert parsed.message.constants == (Constant("S", StringType(), '"x" # no comment', ""),)


def test_a_concatenated_text_gives_each_type() -> None:
    """Types after separators are read with their own package for unqualified names."""
    last = f"{SEPARATOR}MSG: b/C\nint8 x\n"
    text = f"b/B one\n{SEPARATOR}MSG: b/B\nC two\n{last}{last}"
    parsed = parse_definition("a/A", text)
    assert [p.message.name for p in parsed] == ["a/msg/A", "b/msg/B", "b/msg/C"]
    assert parsed[1].message.fields[0].type == NamedType("b/msg/C")


def test_windows_line_ends_change_nothing() -> None:
    """A text with carriage returns gives the same types."""
    text = f"b/B one\n{SEPARATOR}MSG: b/B\nint8 x 5\nstring s 'a'\n"
    plain, windows = (parse_definition("a/A", t) for t in (text, text.replace("\n", "\r\n")))
    assert [p.message for p in plain] == [p.message for p in windows]


@pytest.mark.parametrize(
    ("text", "code", "line"),
    [
        ("int32 a\nnonsense", "TYP002", 2),
        ("int32", "TYP002", 1),
        ("int32 2nd", "TYP002", 1),
        ("int32 a b", "TYP002", 1),
        ("int32 a 1.5", "TYP002", 1),
        ("int32 a = 1\nint32 b 2 3", "TYP002", 2),
        ("int32[0] a", "TYP002", 1),
        ("int32[-1] a", "TYP002", 1),
        ("int32[<=0] a", "TYP002", 1),
        ("int32[<=] a", "TYP002", 1),
        ("int32[2][3] a", "TYP002", 1),
        ("string<=0 a", "TYP002", 1),
        ("int8[4294967296] a", "TYP002", 1),
        ("string<=4294967296[] a", "TYP002", 1),
        ("int64 a " + "9" * 100_000, "TYP002", 1),
        ("float64 a 1e999", "TYP002", 1),
        ("int32<=5 a", "TYP002", 1),
        ("a/b/c/D x", "TYP001", 1),
        ("int32 a\nint8 a", "TYP002", 2),
        ("int32 A=1\nint8 A=2", "TYP002", 2),
        ("int32[] A=[1]", "TYP002", 1),
        ("std_msgs/Header H=1", "TYP002", 1),
        ("std_msgs/Header h 1", "TYP002", 1),
        ("wstring a", "TYP004", 1),
        ("int8 b\nwstring<=5[] a", "TYP004", 2),
        ("long double x", "TYP004", 1),
        ("float128 x", "TYP004", 1),
        (f"int8 a\n{SEPARATOR}int8 b\n", "TYP002", 3),
        (f"int8 a\n{SEPARATOR}", "TYP002", 3),
        (f"int8 a\n{SEPARATOR}MSG: b/B\nint8 a\n{SEPARATOR}MSG: b/B\nint16 a", "TYP005", 6),
        ("int32 " + "a" * 300, "TYP002", 1),
    ],
)
def test_errors_name_the_line(text: str, code: str, line: int) -> None:
    """Every error in a text has its code and the number of its line."""
    with pytest.raises(MessageTypeError) as caught:
        TypeStore.from_definition("a/A", text)
    assert caught.value.code == code
    assert caught.value.where.endswith(f":{line}")


def test_header_means_the_packages_own_in_ros2() -> None:
    """An unqualified Header is the package's own where ROS 2 would find it, else std_msgs'."""
    text = f"Header[2] h\nOther o\n{SEPARATOR}MSG: a/Header\nint8 x\n{SEPARATOR}MSG: a/Other\nint8 y\n"
    own, std = ArrayType(NamedType("a/msg/Header"), 2), ArrayType(NamedType("std_msgs/msg/Header"), 2)
    assert parse_definition("a/A", text)[0].message.fields[0].type == own
    assert parse_definition("a/A", text, ros_version=1)[0].message.fields[0].type == std
    assert parse_definition("b/A", text)[0].message.fields[0].type == std


@pytest.mark.parametrize(
    "line",
    [
        'string s "' + '\\"' * 400_000,
        "string[] s [" + "a" * 500_000 + "]",
        "string[] s [" + '"a",' * 100_000 + "]",
        "string s " + "'" * 500_000,
        "[" * 500_000,
        "string<=" + "9" * 500_000 + " s",
        "a_" * 250_000 + " s",
        "int8 " + "a" * 500_000,
        "@" * 500_000,
        "@a " * 200_000 + "int8 x",
        "=" * 80 + " " * 500_000 + "x",
    ],
)
def test_long_lines_take_no_excessive_time(line: str) -> None:
    """Text of the largest size that is meant to be slow to read is read or refused soon."""
    try:
        TypeStore.from_definition("a/A", line)
    except MessageTypeError as error:
        assert len(str(error)) < 1000


def test_limits_end_the_reading() -> None:
    """Texts with too many bytes or fields, and names too long, are refused."""
    for text in ("#" * (MAX_TEXT + 1), "ä" * (MAX_TEXT // 2 + 1)):
        with pytest.raises(MessageTypeError, match="TYP007"):
            parse_definition("a/A", text)
    half = "".join(f"int8 f{i}\n" for i in range(MAX_FIELDS // 2 + 1))
    with pytest.raises(MessageTypeError, match="TYP007"):
        parse_definition("a/A", f"{half}{SEPARATOR}MSG: b/B\n{half}")
    with pytest.raises(MessageTypeError, match="TYP001"):
        parse_definition("a/" + "A" * 300, "")


def test_depth_is_limited_both_ways() -> None:
    """A chain of types deeper than the limit is refused in whichever order it is given."""

    def chain(depth: int) -> list[tuple[str, str]]:
        return [(f"a/L{i}", f"L{i + 1} x\n" if i < depth - 1 else "int8 x\n") for i in range(depth)]

    for depth, refused in ((32, False), (33, True)):
        top, *rest = chain(depth)
        sections = [f"{SEPARATOR}MSG: {name}\n{text}" for name, text in rest]
        for order in (sections, sections[::-1]):
            text = top[1] + "".join(order)
            if refused:
                with pytest.raises(MessageTypeError, match="TYP007"):
                    TypeStore.from_definition(top[0], text)
            else:
                store = TypeStore.from_definition(top[0], text)
                assert len(store.dependencies(top[0])) == depth
                assert compute_layout(store, top[0]).size == 1


def test_a_long_chain_does_not_exhaust_the_stack() -> None:
    """Thousands of nested types are refused like any other depth."""
    sections = [f"{SEPARATOR}MSG: a/L{i}\nL{i + 1} x\n" for i in range(1, 3000)]
    text = "L1 x\n" + "".join(sections)
    with pytest.raises(MessageTypeError, match=r"TYP007|TYP001"):
        TypeStore.from_definition("a/L0", f"{text}{SEPARATOR}MSG: a/L3000\nint8 x\n")


WORDS = st.sampled_from(
    ["int32", "string", "string<=", "float64", "[", "]", "<=", "5", "-1", " ", "\n", "x", "X=", "=", "#", "'",
     '"', "\\", "/", "std_msgs/Header", "MSG: a/B", SEPARATOR, "time", "@", "wstring", "[1, 2]", "\0", "ä"]
)  # fmt: skip


@settings(max_examples=200, deadline=None)
@given(st.one_of(st.text(max_size=200), st.lists(WORDS, max_size=30).map("".join)))
def test_any_text_is_read_or_refused(text: str) -> None:
    """Whatever the text, the result is a store or a coded error, and stores write themselves back."""
    try:
        store = TypeStore.from_definition("a/A", text)
    except MessageTypeError:
        return
    again = TypeStore.from_definition("a/A", store.definition_text("a/A"))
    assert again["a/A"] == store["a/A"]
    assert again.type_hash("a/A") == store.type_hash("a/A")
