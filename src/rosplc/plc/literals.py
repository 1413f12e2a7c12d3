"""Values as Structured Text literals."""

from __future__ import annotations

import math
from typing import Any

__all__ = ["IEC_TYPES", "literal", "string_literal", "time_literal"]

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
    """Return a primitive's or string's literal.

    Args:
        kind: A ROS primitive, or ``"string"``.
        value: The value; lists give an array initialiser.

    Returns:
        The text; None where no literal exists (infinity, NaN).
    """
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
    """Return a TIME literal, rounded up to whole milliseconds, at most what the type holds (49 days)."""
    return f"T#{min(-(-nanoseconds // 1_000_000), 2**32 - 1)}ms"
