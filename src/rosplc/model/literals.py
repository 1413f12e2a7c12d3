"""Values in ``.msg`` text: constants and default values, read and written.

The grammar is that of ROS 2 ("About ROS 2 interfaces" on https://docs.ros.org); ROS 1's
differs for string constants only, which take the rest of the line as it is.
"""

from __future__ import annotations

import math
import re
import struct

from rosplc.model.types import ArrayType, FieldType, NamedType, PrimitiveType, SequenceType, StringType, Value

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
_ESCAPES = {"n": "\n", "t": "\t", "r": "\r", "\\": "\\", '"': '"', "'": "'"}


class LiteralError(ValueError):
    """A literal does not fit its type; the text says why, without the place."""


def strip_comment(text: str) -> str:
    """Return ``text`` up to a ``#`` that stands outside quotes, stripped."""
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


def parse_value(text: str, kind: FieldType) -> Value:
    """Read the literal of a default value or constant, without a comment; LiteralError if it does not fit."""
    if isinstance(kind, NamedType):
        raise LiteralError(f"a field of type {kind} cannot have a default value")
    if not isinstance(kind, ArrayType | SequenceType):
        return _parse_scalar(text, kind)
    if not (text.startswith("[") and text.endswith("]")):
        raise LiteralError(f"{_cut(text)} is no array literal such as [1, 2]")
    if isinstance(kind.element, NamedType):
        raise LiteralError(f"a field of type {kind} cannot have a default value")
    items = tuple(_parse_scalar(item, kind.element) for item in _split(text[1:-1]))
    if isinstance(kind, ArrayType) and len(items) != kind.length:
        raise LiteralError(f"{len(items)} values for an array of {kind.length}")
    if isinstance(kind, SequenceType) and kind.bound is not None and len(items) > kind.bound:
        raise LiteralError(f"{len(items)} values for a sequence of at most {kind.bound}")
    return items


def format_value(value: Value) -> str:
    """Return the literal that :func:`parse_value` reads back as ``value``."""
    if isinstance(value, tuple):
        return "[" + ", ".join(format_value(item) for item in value) + "]"
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, str):
        escaped = value.replace("\\", "\\\\").replace('"', '\\"')
        return '"' + escaped.replace("\n", "\\n").replace("\t", "\\t").replace("\r", "\\r") + '"'
    return repr(value)


def _parse_scalar(text: str, kind: PrimitiveType | StringType) -> bool | int | float | str:
    if isinstance(kind, StringType):
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
        raise LiteralError(f"{_cut(text)} is no whole number")
    # int() with base 0 refuses leading zeros, which ROS reads as decimal.
    value = int(text, 0) if re.match(r"[+-]?0[xXbBoO]", text) else int(text)
    low, high = INTEGER_RANGES[kind.name]
    if kind.name == "byte" and -128 <= value < 0:
        return value + 256  # its bits are what counts
    if kind.written == "byte" and 128 <= value < 256:
        return value - 256
    if not low <= value <= high:
        raise LiteralError(f"{value} is not within {kind.name} ({low} … {high})")
    return value


def _parse_float(text: str, name: str) -> float:
    if not _FLOAT.match(text):
        raise LiteralError(f"{_cut(text)} is no number")
    value = float(text)
    try:
        struct.pack("<f" if name == "float32" else "<d", value)
        fits = math.isfinite(value) or text.lower().endswith(("inf", "nan"))
    except OverflowError:
        fits = False
    if not fits:
        raise LiteralError(f"{_cut(text)} is not within {name}")
    return value


def _parse_string(text: str, kind: StringType) -> str:
    quoted = _QUOTED.match(text)
    if quoted and quoted.end() == len(text):
        inner = quoted.group(1) if quoted.group(1) is not None else quoted.group(2)
        value = re.sub(r"\\(.)", lambda m: _ESCAPES.get(m[1], m[0]), inner)
    elif text[:1] in ('"', "'"):
        raise LiteralError("a quotation mark is missing")
    else:
        value = text
    if "\0" in value:
        raise LiteralError("a string cannot hold a NUL")
    if kind.bound is not None and len(value.encode("utf-8", "surrogateescape")) > kind.bound:
        raise LiteralError(f"the string is longer than {kind.bound} bytes")
    return value


def _cut(text: str) -> str:
    return repr(text if len(text) <= 60 else text[:57] + "...")


def _split(text: str) -> list[str]:
    """Split an array literal's inside at its commas, respecting quotes."""
    items: list[str] = []
    start = position = 0
    blank = True
    while position < len(text):
        quoted = _QUOTED.match(text, position) if blank else None
        if quoted:
            position = quoted.end()
            blank = False
        elif text[position] == ",":
            items.append(text[start:position].strip())
            position += 1
            start, blank = position, True
        else:
            blank = blank and text[position].isspace()
            position += 1
    if items or text.strip():
        items.append(text[start:].strip())
    return items
