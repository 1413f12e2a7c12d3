"""A slow codec, written from the rules alone, against which the product's codec is held.

It shares nothing with ``rosplc.codec`` and ``rosplc.layout`` but the model of message types:
it walks ``MessageType`` and appends one value at a time. Values are plain data: a message is a
dict, arrays and sequences are lists, strings are ``str``, numbers Python's own.

The rules: CDR (OMG DDS-XTypes 1.3, section 7.4.1, version 1 encoding), ROS 1 (wiki.ros.org/msg),
records (spec/type-mapping.md).
"""

from __future__ import annotations

import math
import random
import struct
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from rosplc.model import ArrayType, FieldType, NamedType, PrimitiveType, SequenceType, StringType, TypeStore

__all__ = ["Oracle", "random_value"]

FORMAT = {
    "bool": "B", "byte": "B", "char": "B", "int8": "b", "uint8": "B", "int16": "h", "uint16": "H",
    "int32": "i", "uint32": "I", "int64": "q", "uint64": "Q", "float32": "f", "float64": "d",
}  # fmt: skip


@dataclass(frozen=True)
class Oracle:
    """Wire bytes and records of the types in ``store``, with one capacity for all of a kind."""

    store: TypeStore
    string: int = 80
    sequence: int = 16

    def cdr(self, type_name: str, value: dict[str, Any], *, little: bool = True) -> bytes:
        """Return the CDR message, with header, padded to a multiple of 4."""
        body = bytearray()
        self._wire(body, NamedType(type_name), value, "<" if little else ">", cdr=True)
        return bytes([0, little, 0, 0]) + bytes(body) + bytes(-len(body) % 4)

    def ros1(self, type_name: str, value: dict[str, Any]) -> bytes:
        """Return the ROS 1 message."""
        body = bytearray()
        self._wire(body, NamedType(type_name), value, "<", cdr=False)
        return bytes(body)

    def record(self, type_name: str, value: dict[str, Any]) -> bytes:
        """Return the record."""
        out = bytearray()
        self._record(out, NamedType(type_name), value)
        return bytes(out)

    def _wire(self, out: bytearray, kind: FieldType, value: Any, order: str, *, cdr: bool) -> None:
        def number(letter: str, item: Any) -> None:
            size = struct.calcsize(letter)
            if cdr:
                out.extend(bytes(-len(out) % size))
            out.extend(struct.pack(order + letter, item))

        if isinstance(kind, PrimitiveType):
            number(FORMAT[kind.name], value)
        elif isinstance(kind, StringType):
            text = value.encode() + (b"\0" if cdr else b"")
            number("I", len(text))
            out.extend(text)
        elif isinstance(kind, NamedType):
            fields = self.store[kind.name].fields
            if not fields and cdr:
                number("B", 0)
            for field in fields:
                self._wire(out, field.type, value[field.name], order, cdr=cdr)
        else:
            if isinstance(kind, SequenceType):
                number("I", len(value))
            for item in value:
                self._wire(out, kind.element, item, order, cdr=cdr)

    def align(self, kind: FieldType) -> int:
        """Return a field's alignment in the record."""
        if isinstance(kind, PrimitiveType):
            return struct.calcsize(FORMAT[kind.name])
        if isinstance(kind, StringType):
            return 1
        if isinstance(kind, NamedType):
            return max((self.align(field.type) for field in self.store[kind.name].fields), default=1)
        return max(self.align(kind.element), 4 if isinstance(kind, SequenceType) else 1)

    def _capacity(self, kind: StringType | SequenceType) -> int:
        default = self.string if isinstance(kind, StringType) else self.sequence
        return default if kind.bound is None else min(default, kind.bound)

    def _record(self, out: bytearray, kind: FieldType, value: Any) -> None:
        """Append a field; None stands for one that is not in use: zeros."""
        if isinstance(kind, PrimitiveType):
            out.extend(bytes(-len(out) % self.align(kind)))
            out.extend(struct.pack("<" + FORMAT[kind.name], 0 if value is None else value))
        elif isinstance(kind, StringType):
            text = (value or "").encode()
            out.extend(text + bytes(self._capacity(kind) + 1 - len(text)))
        elif isinstance(kind, NamedType):
            align = self.align(kind)
            out.extend(bytes(-len(out) % align))
            fields = self.store[kind.name].fields
            if not fields:
                out.append(0)
            for field in fields:
                self._record(out, field.type, None if value is None else value[field.name])
            out.extend(bytes(-len(out) % align))
        elif isinstance(kind, ArrayType):
            for index in range(kind.length):
                self._record(out, kind.element, None if value is None else value[index])
        else:
            items = value or []
            out.extend(bytes(-len(out) % 4))
            out.extend(struct.pack("<I", len(items)))
            for index in range(self._capacity(kind)):
                self._record(out, kind.element, items[index] if index < len(items) else None)


def random_value(oracle: Oracle, type_name: str, rng: random.Random) -> dict[str, Any]:
    """Return random contents that fit the capacities; empty and full ones are common."""
    result = _random(oracle, NamedType(type_name), rng)
    assert isinstance(result, dict)
    return result


def _random(oracle: Oracle, kind: FieldType, rng: random.Random) -> Any:
    if isinstance(kind, PrimitiveType):
        return _NUMBERS.get(kind.name, _integer)(kind.name, rng)
    if isinstance(kind, StringType):
        size, text = rng.choice((0, rng.randint(0, oracle._capacity(kind)), oracle._capacity(kind))), ""
        while len(text.encode()) < size:
            more = rng.choice("aZ09_/ é€𝄞")
            text += more if len((text + more).encode()) <= size else "x"
        return text
    if isinstance(kind, NamedType):
        return {field.name: _random(oracle, field.type, rng) for field in oracle.store[kind.name].fields}
    if isinstance(kind, ArrayType):
        return [_random(oracle, kind.element, rng) for _ in range(kind.length)]
    capacity = oracle._capacity(kind)
    return [
        _random(oracle, kind.element, rng) for _ in range(rng.choice((0, rng.randint(0, capacity), capacity)))
    ]


def _integer(name: str, rng: random.Random) -> int:
    bits = 8 * struct.calcsize(FORMAT[name])
    low, high = (-(1 << bits - 1), (1 << bits - 1) - 1) if name.startswith("int") else (0, (1 << bits) - 1)
    return rng.choice((low, high, rng.randint(low, high)))


def _float(name: str, rng: random.Random) -> float:
    any_size = math.ldexp(rng.randint(-(1 << 20), 1 << 20), rng.randint(-140, 100))
    value = rng.choice((0.0, -0.0, float("inf"), float("nan"), any_size))
    return float(struct.unpack("<f", struct.pack("<f", value))[0]) if name == "float32" else value


_NUMBERS: dict[str, Callable[[str, random.Random], Any]] = {
    "float32": _float,
    "float64": _float,
    "bool": lambda _name, rng: rng.random() < 0.5,
}
