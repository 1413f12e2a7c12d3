"""Conversion between bytes and values, for messages that the node itself reads and writes.

The bytes are CDR, or ROS 1 serialization for ROS 1 types.
"""

from __future__ import annotations

import struct
from collections.abc import Mapping
from typing import Any

from rosplc.errors import BackendError, CodecError
from rosplc.model import ArrayType, FieldType, NamedType, PrimitiveType, SequenceType, TypeStore
from rosplc.model.types import FORMATS, PRIMITIVES


def unpack(store: TypeStore, type_name: str, payload: bytes) -> dict[str, Any]:
    """Return a message's fields, inner messages as mappings; ROS008 if the bytes do not fit."""
    return unpack_first(store, type_name, payload, None)[0]


def unpack_first(
    store: TypeStore, type_name: str, payload: bytes, count: int | None
) -> tuple[dict[str, Any], bytes]:
    """Return the first ``count`` fields of a message as :func:`unpack`, and the remaining bytes."""
    try:
        reader = Reader(store, payload)
        return reader.message(type_name, count), reader.rest()
    except (struct.error, IndexError) as error:
        raise BackendError("ROS008", f"cannot read a message of type {type_name}: {error}") from error


def unpack_whole(store: TypeStore, type_name: str, payload: bytes) -> dict[str, Any]:
    """Return a message as :func:`unpack`; COD001, COD002 or COD003 if the bytes are not such a message."""
    cdr = store.ros_version == 2
    if cdr and len(payload) >= 4 and payload[:2] not in (b"\0\0", b"\0\1"):
        raise CodecError("COD003", f"encapsulation 0x{payload[:2].hex()} is neither 0x0000 nor 0x0001")
    try:
        value, rest = unpack_first(store, type_name, payload, None)
    except BackendError as error:
        raise CodecError("COD001", error.what) from error
    if len(rest) > (3 if cdr else 0):
        raise CodecError("COD002", f"{len(rest)} bytes are left over")
    return value


def pack(store: TypeStore, type_name: str, values: Mapping[str, Any]) -> bytes:
    """Return a message's bytes; missing fields are zero or empty."""
    writer = _Writer(store)
    writer.message(type_name, values)
    return bytes(writer.out) if writer.ros1 else b"\0\1\0\0" + bytes(writer.out)


def time(ns: int) -> dict[str, int]:
    """Return a time in ns since 1970 as the fields of a message's stamp."""
    # An int32 in ROS 2; from 2038 on its bits are those of ROS 1's uint32, which lasts until 2106.
    return {"sec": (ns // 10**9 + 2**31) % 2**32 - 2**31, "nanosec": ns % 10**9}


class Reader:
    """A read position in a message; raises struct.error or IndexError where the bytes do not fit."""

    def __init__(self, store: TypeStore, payload: bytes) -> None:
        self._store, self._at = store, 0
        self._ros1 = store.ros_version == 1
        self._body = memoryview(payload)[0 if self._ros1 else 4 :]
        self._order = "<" if self._ros1 or payload[1] & 1 else ">"

    def message(self, name: str, count: int | None = None) -> dict[str, Any]:
        """Return ``count`` fields of a message; None: all."""
        fields = self._store[name].fields
        if not fields and not self._ros1:
            self._numbers("uint8", 1)  # CDR has no empty structures
        return {field.name: self._value(field.type) for field in fields[:count]}

    def rest(self) -> bytes:
        """Return the bytes after the current position."""
        return bytes(self._body[self._at :])

    def _value(self, kind: FieldType) -> Any:
        if isinstance(kind, SequenceType | ArrayType):
            count = kind.length if isinstance(kind, ArrayType) else self._count()
            if isinstance(kind, SequenceType) and count > len(self._body):
                raise IndexError(f"{count} elements")  # those without a size would be counted without end
            return self._values(kind.element, count)
        return self._values(kind, 1)[0]

    def _values(self, kind: FieldType, count: int) -> Any:
        if isinstance(kind, PrimitiveType):
            return self._numbers(kind.name, count)
        if isinstance(kind, NamedType):
            return [self.message(kind.name) for _ in range(count)]
        texts = (self._numbers("uint8", self._count()) for _ in range(count))
        end = b"" if self._ros1 else b"\0"
        return [text.removesuffix(end).decode(errors="surrogateescape") for text in texts]

    def _count(self) -> int:
        return int(self._numbers("uint32", 1)[0])

    def _skip(self, name: str, count: int) -> int:
        """Skip some numbers, and return where they begin."""
        width = PRIMITIVES[name]
        at = self._at + (-self._at % width if count and not self._ros1 else 0)
        self._at = at + count * width
        return at

    def _numbers(self, name: str, count: int) -> Any:
        letter = FORMATS[name]
        layout = f"{count}s" if letter == "B" else f"{self._order}{count}{letter}"
        found = struct.unpack_from(layout, self._body, self._skip(name, count))
        return found[0] if letter == "B" else list(found)


class _Writer:
    def __init__(self, store: TypeStore) -> None:
        self._store, self.out = store, bytearray()
        self.ros1 = store.ros_version == 1

    def message(self, name: str, values: Mapping[str, Any]) -> None:
        found = self._store[name].fields
        for field in found:
            self._value(field.type, values.get(field.name))
        if not found and not self.ros1:
            self._numbers("uint8", [0])

    def _value(self, kind: FieldType, value: Any) -> None:
        if isinstance(kind, SequenceType):
            self._numbers("uint32", (len(value or ()),))
        if isinstance(kind, ArrayType | SequenceType):
            count = kind.length if isinstance(kind, ArrayType) else 0
            self._values(kind.element, value or [0] * count)
        else:
            self._values(kind, [value or 0])

    def _values(self, kind: FieldType, values: Any) -> None:
        if isinstance(kind, PrimitiveType):
            self._numbers(kind.name, values)
        elif isinstance(kind, NamedType):
            for value in values:
                self.message(kind.name, value or {})
        else:
            for value in values:
                text = (value or "").encode(errors="surrogateescape") + b"\0" * (not self.ros1)
                self._numbers("uint32", (len(text),))
                self.out += text

    def _numbers(self, name: str, values: Any) -> None:
        if values and not self.ros1:
            self.out += bytes(-len(self.out) % PRIMITIVES[name])
        plain = isinstance(values, bytes)
        self.out += values if plain else struct.pack(f"<{len(values)}{FORMATS[name]}", *values)
