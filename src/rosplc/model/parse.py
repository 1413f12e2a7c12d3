"""``.msg`` text → message types, with the line of every error.

A text holds one definition, or several as ROS tools concatenate them (spec/type-mapping.md, section 6). It
may come from an object or a recording and is not trusted: sizes are limited and nothing in it is executed.

The grammar, also of constants and default values, is that of ROS 2 ("About ROS 2 interfaces" on
https://docs.ros.org); ROS 1's differs for string constants, which take the rest of the line as it is.
"""

from __future__ import annotations

import math
import re
import struct
from collections.abc import Collection, Iterator
from dataclasses import dataclass

from rosplc.errors import MessageTypeError
from rosplc.model import types
from rosplc.model._rosbags import parse_field_type

# Integer primitive → smallest and largest value.
INTEGER_RANGES: dict[str, tuple[int, int]] = {
    "byte": (0, 255),
    "char": (0, 255),
    **{f"uint{bits}": (0, 2**bits - 1) for bits in (8, 16, 32, 64)},
    **{f"int{bits}": (-(2 ** (bits - 1)), 2 ** (bits - 1) - 1) for bits in (8, 16, 32, 64)},
}

# Underscores between digits: ROS reads numbers as Python does.
_INTEGER = re.compile(
    r"[+-]?(0[xX](_?[0-9a-fA-F])+|0[bB](_?[01])+|0[oO](_?[0-7])+|[0-9](_?[0-9])*)\Z", re.ASCII
)
_DIGITS = "[0-9](_?[0-9])*"
_FLOAT = re.compile(
    rf"[+-]?(({_DIGITS}(\.({_DIGITS})?)?|\.{_DIGITS})([eE][+-]?{_DIGITS})?|inf|nan)\Z", re.IGNORECASE
)
_QUOTED = re.compile(r""""((?:\\.|[^"\\])*)"|'((?:\\.|[^'\\])*)'""")
_ITEM = re.compile(rf"\s*({_QUOTED.pattern})?[^,]*,")
_ESCAPES = {"n": "\n", "t": "\t", "r": "\r", "\\": "\\", '"': '"', "'": "'"}


class LiteralError(ValueError):
    """A literal does not fit its type; the text gives the reason, without the place."""


def strip_comment(text: str) -> str:
    """Return ``text`` up to a ``#`` outside quotes, stripped."""
    position = 0
    while position < len(text):
        if text[position] == "#":
            return text[:position].strip()
        # An apostrophe within an unquoted text opens no quotation. (Looking for a quotation
        # at every quote would also take quadratic time with escaped ones.)
        opens = position == 0 or text[position - 1] in " \t[,="
        quoted = _QUOTED.match(text, position) if opens else None
        position = quoted.end() if quoted else position + 1
    return text.strip()


def parse_value(text: str, kind: types.FieldType) -> types.Value:
    """Read the literal of a default value or constant, without a comment; LiteralError if it does not fit."""
    if isinstance(kind, types.NamedType):
        raise LiteralError(f"a field of type {kind} cannot have a default value")
    if not isinstance(kind, types.ArrayType | types.SequenceType):
        return _parse_scalar(text, kind)
    if not (text.startswith("[") and text.endswith("]")):
        raise LiteralError(f"{_cut(text)} is not an array literal such as [1, 2]")
    if isinstance(kind.element, types.NamedType):
        raise LiteralError(f"a field of type {kind} cannot have a default value")
    items = tuple(_parse_scalar(item, kind.element) for item in _split(text[1:-1]))
    if isinstance(kind, types.ArrayType) and len(items) != kind.length:
        raise LiteralError(f"got {len(items)} values for an array of {kind.length}")
    if isinstance(kind, types.SequenceType) and kind.bound is not None and len(items) > kind.bound:
        raise LiteralError(f"got {len(items)} values for a sequence of at most {kind.bound}")
    return items


def format_value(value: types.Value) -> str:
    """Return the literal that :func:`parse_value` reads back as ``value``."""
    if isinstance(value, tuple):
        return "[" + ", ".join(format_value(item) for item in value) + "]"
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, str):
        escaped = value.replace("\\", "\\\\").replace('"', '\\"')
        return '"' + escaped.replace("\n", "\\n").replace("\t", "\\t").replace("\r", "\\r") + '"'
    return repr(value)


def _parse_scalar(text: str, kind: types.PrimitiveType | types.StringType) -> bool | int | float | str:
    if isinstance(kind, types.StringType):
        return _parse_string(text, kind)
    if kind.name == "bool":
        truth = {"true": True, "1": True, "false": False, "0": False}.get(text.lower())
        if truth is None:
            raise LiteralError(f"{_cut(text)} is neither true nor false")
        return truth
    if kind.name in ("float32", "float64"):
        return _parse_float(text, kind.name)
    # Longer ones fit no type, and Python refuses to convert thousands of digits.
    if not _INTEGER.match(text) or len(text) > 80:
        raise LiteralError(f"{_cut(text)} is not a whole number")
    # int() with base 0 refuses leading zeros, which ROS reads as decimal.
    value = int(text, 0) if re.match(r"[+-]?0[xXbBoO]", text) else int(text)
    low, high = INTEGER_RANGES[kind.name]
    if kind.name == "byte" and -128 <= value < 0:
        return value + 256  # its bits are what counts
    if kind.written == "byte" and 128 <= value < 256:
        return value - 256
    if not low <= value <= high:
        raise LiteralError(f"{value} is outside the range of {kind.name} ({low} … {high})")
    return value


def _parse_float(text: str, name: str) -> float:
    if not _FLOAT.match(text):
        raise LiteralError(f"{_cut(text)} is not a number")
    value = float(text)
    try:
        struct.pack("<f" if name == "float32" else "<d", value)
        fits = math.isfinite(value) or text.lower().endswith(("inf", "nan"))
    except OverflowError:
        fits = False
    if not fits:
        raise LiteralError(f"{_cut(text)} is outside the range of {name}")
    return value


def _parse_string(text: str, kind: types.StringType) -> str:
    quoted = _QUOTED.match(text)
    if quoted and quoted.end() == len(text):
        inner = quoted.group(1) if quoted.group(1) is not None else quoted.group(2)
        value = re.sub(r"\\(.)", lambda m: _ESCAPES.get(m[1], m[0]), inner)
    elif text[:1] in ('"', "'"):
        raise LiteralError("the closing quotation mark is missing")
    else:
        value = text
    if "\0" in value:
        raise LiteralError("a string cannot contain a NUL")
    if kind.bound is not None and len(value.encode("utf-8", "surrogateescape")) > kind.bound:
        raise LiteralError(f"the string is longer than {kind.bound} bytes")
    return value


def _cut(text: str) -> str:
    return repr(text if len(text) <= 60 else text[:57] + "...")


def _split(text: str) -> list[str]:
    """Split an array literal's inside at its commas, respecting quotes."""
    items = [found[0][:-1].strip() for found in _ITEM.finditer(f"{text},")]
    return [] if items == [""] else items


MAX_TEXT = 1 << 20  # Largest definition text in bytes.
MAX_FIELDS = 10_000  # Most fields and constants in one definition text.
MAX_NAME = 255  # Longest type, field or constant name.

_SEPARATOR = re.compile(r"={80}\s*\Z")
_HEADER = re.compile(r"MSG:\s*(\S+)\s*\Z")
_TYPE_NAME = re.compile(r"([A-Za-z][A-Za-z0-9_]*)/(?:(msg|srv|action)/)?([A-Za-z][A-Za-z0-9_]*)\Z")
_NAME = re.compile(r"[A-Za-z][A-Za-z0-9_]*\Z")
_LINE = re.compile(r"(\S+)\s+([A-Za-z][A-Za-z0-9_]*)\s*(.*)\Z", re.DOTALL)
_ANNOTATIONS = re.compile(r"(@[a-z_]+(\s+|\Z))*")
_HALF = re.compile("[\ud800-\udfff]")
_UNSUPPORTED = re.compile(r"(wstring|wchar|float128|long\s+double)\b(?!/)")


@dataclass(frozen=True, slots=True)
class ParsedType:
    """One definition of a text, with the places that later errors name."""

    message: types.MessageType
    where: str
    field_lines: tuple[str, ...]


def full_name(name: str, kind: str = "msg") -> str:
    """Return ``package/msg/Name`` for ``package/Name``; a name of three parts as it is.

    ``kind`` is the middle for a name of two: ``msg``, ``srv`` or ``action``. Raises MessageTypeError TYP001.
    """
    found = _TYPE_NAME.match(name) if len(name) <= MAX_NAME else None
    if not found:
        raise MessageTypeError("TYP001", f"{name[:80]!r} is not a type name such as geometry_msgs/msg/Twist")
    return f"{found[1]}/{found[2] or kind}/{found[3]}"


def check_names(message: types.MessageType) -> None:
    """Check the names of a type that was not parsed: they become identifiers of generated code.

    Raises MessageTypeError TYP001 for the type's name, TYP002 for a field's or constant's.
    """
    if full_name(message.name) != message.name:
        raise MessageTypeError("TYP001", f"{message.name!r} is not a full name like geometry_msgs/msg/Twist")
    seen: set[str] = set()
    items: list[types.Field | types.Constant] = [*message.fields, *message.constants]
    for item in items:
        if not _NAME.match(item.name) or len(item.name) > MAX_NAME or item.name in seen:
            what = "is defined twice" if item.name in seen else "is not a valid field or constant name"
            raise MessageTypeError("TYP002", f"{item.name[:80]!r} {what}", where=message.name)
        seen.add(item.name)


def parse_definition(
    type_name: str, text: str, *, where: str = "", ros_version: int = 2, siblings: Collection[str] = ()
) -> list[ParsedType]:
    """Parse a definition text: the type ``type_name``, then others after lines of 80 ``=``.

    ``where`` is the place that errors name, usually a file; by default the type's name. ``siblings`` are full
    names of types outside of the text. In ROS 1 string constants are read differently, and ``Header`` is
    always std_msgs' one; in ROS 2 it is the package's own if it has one.

    Raises MessageTypeError TYP002 (syntax), TYP004 (unsupported type), TYP005 (a type twice with different
    content) or TYP007 (limits).
    """
    where = where or type_name
    if len(text) > MAX_TEXT or len(text.encode("utf-8", "surrogatepass")) > MAX_TEXT:
        raise MessageTypeError("TYP007", f"the definition has more than {MAX_TEXT} bytes", where=where)
    # JSON can hold halves of characters: no file can, and no hash has a form for them.
    if half := _HALF.search(text):
        number = text.count("\n", 0, half.start()) + 1
        raise _syntax(f"{half[0]!r} is not a valid character", where, number)
    found: dict[str, ParsedType] = {}
    budget = MAX_FIELDS
    sections = list(_sections(full_name(type_name), text, where))
    own_headers = {*siblings, *(name for name, _, _ in sections)} if ros_version == 2 else set()
    for name, place, lines in sections:
        own = name.partition("/")[0] + "/msg/Header"
        if own in own_headers:  # a field type `Header` is that of the package
            lines = [(n, re.sub(r"^(\s*)Header(?=[\s\[])", rf"\1{own}", line)) for n, line in lines]
        parsed = _parse_section(name, place, lines, where, ros_version, budget)
        budget -= len(parsed.message.fields) + len(parsed.message.constants)
        known = found.setdefault(name, parsed)
        if known.message != parsed.message:
            raise MessageTypeError("TYP005", f"{name} has two different definitions", where=place)
    return list(found.values())


def _sections(name: str, text: str, where: str) -> Iterator[tuple[str, str, list[tuple[int, str]]]]:
    """Yield name, place and numbered lines of each definition in a concatenated text."""
    place = where
    lines: list[tuple[int, str]] = []
    wants_header = False
    # Only line feeds end a line: str.splitlines() would also split at exotic characters.
    for number, raw in enumerate(text.split("\n"), 1):
        line = raw.rstrip("\r")
        if wants_header:
            header = _HEADER.match(line)
            if not header:
                raise _syntax("a line of 80 `=` must be followed by `MSG: package/Name`", where, number)
            name, place, lines, wants_header = full_name(header[1]), f"{where}:{number}", [], False
        elif _SEPARATOR.match(line):
            yield name, place, lines
            wants_header = True
        else:
            lines.append((number, line))
    if wants_header:
        raise _syntax("the definition ends after a separator line", where, text.count("\n") + 1)
    yield name, place, lines


def _parse_section(
    name: str, place: str, lines: list[tuple[int, str]], where: str, ros_version: int, budget: int
) -> ParsedType:
    fields: list[types.Field] = []
    constants: list[types.Constant] = []
    places: list[str] = []
    names: set[str] = set()
    for number, raw in lines:
        line = _ANNOTATIONS.sub("", raw.strip(), count=1)
        if not line or line.startswith("#"):
            continue
        if _UNSUPPORTED.match(line):
            raise MessageTypeError("TYP004", f"unsupported type in {line[:80]!r}", where=f"{where}:{number}")
        try:
            item = _parse_line(line, name.partition("/")[0], ros_version)
        except LiteralError as error:
            raise _syntax(str(error), where, number) from None
        if item.name in names:
            raise _syntax(f"{item.name} is defined twice", where, number)
        names.add(item.name)
        if len(names) > budget:
            raise MessageTypeError("TYP007", f"too many fields: over {MAX_FIELDS}", where=f"{where}:{number}")
        if isinstance(item, types.Constant):
            constants.append(item)
        else:
            fields.append(item)
            places.append(f"{where}:{number}")
    return ParsedType(types.MessageType(name, tuple(fields), tuple(constants)), place, tuple(places))


def _parse_line(line: str, package: str, ros_version: int) -> types.Field | types.Constant:
    parts = _LINE.match(line)
    if not parts:
        raise LiteralError(f"{line[:80]!r} is neither `type name` nor `type NAME=value`")
    type_text, name, rest = parts.groups()
    if len(name) > MAX_NAME or len(type_text) > 2 * MAX_NAME:
        raise LiteralError(f"a name has more than {MAX_NAME} characters")
    if (found := parse_field_type(type_text, package, ros1=ros_version == 1)) is None:
        raise LiteralError(f"{type_text[:80]!r} is not a valid type")
    kind, valid = found
    if not valid:
        raise LiteralError(f"{type_text[:80]!r}: lengths and bounds must be from 1 to 4294967295")
    if rest.startswith("="):
        return _parse_constant(name, kind, rest[1:], ros_version)
    literal = strip_comment(rest)
    return types.Field(name, kind, parse_value(literal, kind) if literal else None)


def _parse_constant(name: str, kind: types.FieldType, text: str, ros_version: int) -> types.Constant:
    if not isinstance(kind, types.PrimitiveType | types.StringType):
        raise LiteralError(f"a constant cannot be of type {kind}")
    if isinstance(kind, types.StringType) and ros_version == 1:
        literal = text.strip()  # no comments and no quotes there: http://wiki.ros.org/msg
        return types.Constant(name, kind, literal, literal)
    literal = strip_comment(text)
    value = parse_value(literal, kind)
    assert not isinstance(value, tuple)
    return types.Constant(name, kind, value, literal)


def _syntax(what: str, where: str, number: int) -> MessageTypeError:
    return MessageTypeError("TYP002", what, where=f"{where}:{number}")
