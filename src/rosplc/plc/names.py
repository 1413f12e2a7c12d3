"""Identifiers: from ROS names to names that every Structured Text compiler accepts.

IEC 61131-3 identifiers are letters, digits and single underscores, not ending with one, and
case does not tell two apart. A name that is a keyword, or collides with another in the same
scope, is renamed by a fixed rule, and every renaming is kept for the table in the output.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from functools import cache
from importlib.resources import files

__all__ = ["Scope", "is_reserved", "legal", "type_prefix"]

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
    """Return whether a compiler may take the name for something of its own."""
    upper = name.upper()
    return upper in _reserved() or bool(_CONVERSION.match(upper))


def legal(name: str) -> str:
    """Return the name with what no identifier may hold replaced; reserved words get a ``_`` before.

    ``type`` → ``_type``, ``a__b`` → ``a_b``, ``data_`` → ``data``.
    """
    text = re.sub(r"[^A-Za-z0-9_]", "_", name)
    text = re.sub(r"_+", "_", text).rstrip("_") or "unnamed"
    if text[0].isdigit() or is_reserved(text):
        text = f"_{text}"
    return text


def type_prefix(type_name: str) -> str:
    """Return the name that everything about a type starts with: ``geometry_msgs_Twist``."""
    package, _, name = type_name.replace("/msg/", "/").partition("/")
    return legal(f"{package}_{name}")


class Scope:
    """Names of one scope: hands out each only once, whatever the case.

    Args:
        taken: Names that exist already.

    Attributes:
        renamed: ``(wanted, given)`` for each name that had to change, in order.
    """

    def __init__(self, taken: Iterable[str] = ()) -> None:
        self._taken = {name.upper() for name in taken}
        self.renamed: list[tuple[str, str]] = []

    def give_all(self, wanted: Sequence[str]) -> tuple[str, ...]:
        """Return a name for each; names that are legal as they are get theirs before those that change."""
        order = sorted(range(len(wanted)), key=lambda index: legal(wanted[index]) != wanted[index])
        given = {index: self.give(wanted[index]) for index in order}
        return tuple(given[index] for index in range(len(wanted)))

    def give(self, wanted: str) -> str:
        """Return a free legal name as near to ``wanted`` as possible."""
        base = legal(wanted)
        name, number = base, 2
        while name.upper() in self._taken:
            name = f"{base}_{number}" if not base[-1].isdigit() else f"{base}_v{number}"
            number += 1
        self._taken.add(name.upper())
        if name != wanted:
            self.renamed.append((wanted, name))
        return name
