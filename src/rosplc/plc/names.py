"""Identifiers and literals that every Structured Text compiler accepts.

IEC 61131-3 identifiers consist of letters, digits and single underscores, not at the end; case is ignored.
A name that is a keyword or collides within its scope is renamed by a fixed rule and listed in the output.
"""

from __future__ import annotations

import hashlib
import math
import re
from collections import Counter
from collections.abc import Iterable, Sequence
from functools import cache
from importlib.resources import files
from typing import Any

# BOOL_TO_INT, TO_INT and the like are operators of their own.
_ELEMENTARY = (
    "BOOL|BIT|BYTE|WORD|DWORD|LWORD|SINT|INT|DINT|LINT|USINT|UINT|UDINT|ULINT|REAL|LREAL|CHAR|WCHAR|STRING|WSTRING"
    "|TIME|LTIME|DATE|LDATE|DT|LDT|TOD|LTOD"
)
_CONVERSION = re.compile(rf"(?:(?:{_ELEMENTARY})_)?TO_(?:{_ELEMENTARY})\Z")


@cache
def _reserved() -> frozenset[str]:
    text = files("rosplc.plc").joinpath("templates/reserved_words.txt").read_text(encoding="ascii")
    return frozenset(line for line in text.split() if line.isupper() and not line.startswith("#"))


def is_reserved(name: str) -> bool:
    """Return whether the name may be reserved by a compiler."""
    upper = name.upper()
    return upper in _reserved() or bool(_CONVERSION.match(upper))


def legal(name: str) -> str:
    """Return a legal name: ``type`` (reserved) → ``_type``, ``a__b`` → ``a_b``, ``data_`` → ``data``."""
    text = re.sub(r"[^A-Za-z0-9_]", "_", name)
    text = re.sub(r"_+", "_", text).rstrip("_") or "unnamed"
    if text[0].isdigit() or is_reserved(text):
        text = f"_{text}"
    return text


def type_prefix(type_name: str) -> str:
    """Return the prefix of all names for a type: ``geometry_msgs_Twist``."""
    package, _, name = type_name.partition("/")
    return legal(f"{package}_{name.rpartition('/')[2]}")


class Scope:
    """The names of one scope, including ``taken``; each is given only once, ignoring case."""

    def __init__(self, taken: Iterable[str] = ()) -> None:
        self._taken = {name.upper() for name in taken}
        # ``(wanted, given)`` for each name that had to change, in order
        self.renamed: list[tuple[str, str]] = []

    def give_all(self, wanted: Sequence[str]) -> tuple[str, ...]:
        """Return a name for each; names that are already legal are given first."""
        order = sorted(range(len(wanted)), key=lambda index: legal(wanted[index]) != wanted[index])
        given = {index: self.give(wanted[index]) for index in order}
        return tuple(given[index] for index in range(len(wanted)))

    def give(self, wanted: str) -> str:
        """Return a free legal name as close to ``wanted`` as possible."""
        base = legal(wanted)
        name, number = base, 2
        while name.upper() in self._taken:
            name = f"{base}_{number}" if not base[-1].isdigit() else f"{base}_v{number}"
            number += 1
        self._taken.add(name.upper())
        if name != wanted:
            self.renamed.append((wanted, name))
        return name


def plain_name(topic: str) -> str:
    """Return the preferred name of a topic's instance: ``robot1_pose``."""
    return topic.strip("/").replace("/", "_")


def instance_names(topics: Sequence[str]) -> dict[str, str]:
    """Return the instance name of each topic of a variable list.

    If topics would share a name, each of them gets a suffix derived from its topic: a new topic may
    make programs fail to compile, but a name never refers to another topic.
    """
    count = Counter(legal(plain_name(topic)).upper() for topic in topics)
    scope = Scope(name for name, times in count.items() if times > 1)
    names: dict[str, str] = {}
    for topic in sorted(topics):
        name = legal(plain_name(topic))
        if count[name.upper()] > 1:
            name += f"_{hashlib.sha256(topic.encode()).hexdigest()[:4]}"
        names[topic] = scope.give(name)
    return names


IEC_TYPES = {
    "bool": "BOOL", "byte": "BYTE", "char": "USINT",
    "int8": "SINT", "uint8": "USINT", "int16": "INT", "uint16": "UINT",
    "int32": "DINT", "uint32": "UDINT", "int64": "LINT", "uint64": "ULINT",
    "float32": "REAL", "float64": "LREAL",
}  # fmt: skip
"""ROS primitive → IEC 61131-3 elementary type (spec/type-mapping.md, section 1)."""

_ESCAPES = {"$": "$$", "'": "$'", "\n": "$N", "\r": "$R", "\t": "$T", "\f": "$P"}


def string_literal(text: str) -> str:
    """Return a single-byte string literal; bytes outside printable ASCII are written ``$xx``."""
    parts: list[str] = []
    for byte in text.encode("utf-8", "surrogateescape"):
        char = chr(byte)
        if char in _ESCAPES:
            parts.append(_ESCAPES[char])
        elif 32 <= byte < 127:
            parts.append(char)
        else:
            parts.append(f"${byte:02X}")
    return "'" + "".join(parts) + "'"


def literal(kind: str, value: Any) -> str | None:
    """Return the literal of a primitive or "string"; lists as array initializers; None for infinity, NaN."""
    if isinstance(value, (list, tuple)):
        parts = [literal(kind, item) for item in value]
        return None if None in parts or not parts else "[" + ", ".join(str(p) for p in parts) + "]"
    if kind == "string":
        return string_literal(str(value))
    if kind == "bool":
        return "TRUE" if value else "FALSE"
    if kind.startswith("float"):
        number = float(value)
        if not math.isfinite(number):
            return None
        text = repr(number)
        if "e" in text:
            mantissa, _, exponent = text.partition("e")
            return f"{mantissa if '.' in mantissa else mantissa + '.0'}E{int(exponent)}"
        return text
    number = int(value)
    if kind == "int64" and number == -(2**63):
        return "-9223372036854775807 - 1"  # the positive number alone would not fit
    if kind == "uint64" and number >= 2**63:
        return f"ULINT#{number}"
    return str(number)


def time_literal(nanoseconds: int) -> str:
    """Return a TIME literal, rounded up to whole milliseconds and limited to the type's maximum (49 days)."""
    return f"T#{min(-(-nanoseconds // 1_000_000), 2**32 - 1)}ms"
