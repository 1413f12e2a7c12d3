"""Numbers → record bytes, one by one and in bulk.

Bulk that lies in memory as the record wants it (bytes, array, numpy) is copied, else it goes through struct.
"""

from __future__ import annotations

import operator
import struct
import sys
from collections.abc import Callable
from typing import TYPE_CHECKING, Any, TypeAlias

if TYPE_CHECKING:
    from rosplc.layout.nodes import ScalarNode


# Primitive → `struct` format character.
FORMATS = {
    "bool": "?", "byte": "B", "char": "B", "uint8": "B", "int8": "b", "uint16": "H", "int16": "h",
    "uint32": "I", "int32": "i", "uint64": "Q", "int64": "q", "float32": "f", "float64": "d",
}  # fmt: skip

Pack: TypeAlias = "Callable[[bytearray, int, Any], None]"  # Writes a value at an offset.


class Misfit(Exception):
    """A value does not fit; ``path`` grows from the inside out while this travels up."""

    def __init__(self, what: str) -> None:
        super().__init__(what)
        self.what = what
        self.path: list[str] = []

    def where(self) -> str:
        """Return the field path, such as ``points[3].x``."""
        text = ""
        for part in reversed(self.path):
            text += part if part.startswith("[") or not text else f".{part}"
        return text


def scalar_packer(kind: str) -> Pack:
    """Return how to write one value of a primitive."""
    pack_into = struct.Struct("<" + FORMATS[kind]).pack_into
    convert = _converter(kind)

    def pack(buffer: bytearray, offset: int, value: Any) -> None:
        try:
            pack_into(buffer, offset, convert(value))
        except (TypeError, ValueError, OverflowError, struct.error):
            raise Misfit(f"{describe(value)} is no {kind}") from None

    return pack


def _converter(kind: str) -> Callable[[Any], Any]:
    if kind == "bool":
        return _to_bool
    if kind in ("float32", "float64"):
        return _to_float
    return _to_octet if kind in ("byte", "char") else operator.index


def _to_bool(value: Any) -> bool:
    # numpy's bool has neither __index__ nor bool as its base.
    if isinstance(value, bool) or type(value).__name__ in ("bool_", "bool"):
        return bool(value)
    number = operator.index(value)
    if number not in (0, 1):
        raise ValueError
    return number == 1


def _to_float(value: Any) -> float:
    if isinstance(value, str | bytes | bytearray):
        raise TypeError
    return float(value)


def _to_octet(value: Any) -> int:
    if isinstance(value, bytes) and len(value) == 1:  # rclpy's form of a byte
        return value[0]
    number = operator.index(value)
    return number + 256 if -128 <= number < 0 else number  # rospy's byte is signed


def each_packer(pack: Pack, stride: int) -> Callable[[bytearray, int, Any], None]:
    """Return how to write elements one after the other, naming the first that does not fit."""

    def fill(buffer: bytearray, offset: int, items: Any) -> None:
        for index, item in enumerate(items):
            try:
                pack(buffer, offset + index * stride, item)
            except Misfit as misfit:
                misfit.path.append(f"[{index}]")
                raise

    return fill


def numbers_packer(node: ScalarNode) -> Callable[[bytearray, int, Any], None]:
    """Return how to write a list, or a one-dimensional memoryview, of numbers."""
    one_by_one = each_packer(scalar_packer(node.kind), node.size)
    code = FORMATS[node.kind]
    same = _buffer_formats(code, node.size)

    def fill(buffer: bytearray, offset: int, items: Any) -> None:
        if isinstance(items, memoryview):
            if items.format in same and items.itemsize == node.size:
                native = items.c_contiguous and len(items.format) == 1
                data = items.cast("B") if native else items.tobytes()
                buffer[offset : offset + items.nbytes] = data
                return
            items = items.tolist()
        if code != "?":  # struct takes the truth of anything as a bool
            try:
                struct.pack_into(f"<{len(items)}{code}", buffer, offset, *items)
            except (TypeError, ValueError, OverflowError, struct.error):
                pass  # some element needs conversion, or does not fit: find out which
            else:
                return
        one_by_one(buffer, offset, items)

    return fill


def _buffer_formats(code: str, size: int) -> frozenset[str]:
    """Return the buffer formats whose bytes are the record's bytes already."""
    if sys.byteorder != "little":  # pragma: no cover - no big-endian machine at hand
        return frozenset()
    classes = ("bhilq", "BHILQ", "fd", "?")
    letters = next(letters for letters in classes if code in letters) if size > 1 else code
    return frozenset(prefix + letter for letter in letters for prefix in ("", "<", "=", "@"))


def describe(value: Any) -> str:
    """Return a value and its type for an error, shortened."""
    text = repr(value)
    return f"{text if len(text) <= 60 else text[:57] + '...'} ({type(value).__name__})"
