"""How a message becomes Modbus registers: two per number, most significant word first, strings left out.

That is what devices and their users do: a register has 16 bits, a REAL takes two. A 64-bit float is
rounded to a 32-bit one, and a string has no place.
"""

from __future__ import annotations

import struct
from collections.abc import Sequence
from typing import Any

from rosplc.bench.end_to_end_messages import Kind

__all__ = ["READ_LIMIT", "WRITE_LIMIT", "pack", "pieces", "size", "unpack"]

READ_LIMIT = 125
"""Registers that one request may read (FC03)."""
WRITE_LIMIT = 123
"""Registers that one request may write (FC16)."""


def _format(kind: Kind) -> str:
    text = ">"
    for path in kind.paths:
        last = path.rpartition(".")[2]
        if last in ("frame_id", "name"):
            continue
        text += {"sec": "i", "nanosec": "I"}.get(last, f"{kind.length or 1}f")
    return text


def pack(kind: Kind, leaves: Sequence[Any]) -> list[int]:
    """Return the registers of a message."""
    numbers: list[Any] = []
    for path, value in zip(kind.paths, leaves, strict=True):
        if path.rpartition(".")[2] not in ("frame_id", "name"):
            numbers.extend(value if isinstance(value, list) else (value,))
    data = struct.pack(_format(kind), *numbers)
    return list(struct.unpack(f">{len(data) // 2}H", data))


def unpack(kind: Kind, registers: Sequence[int]) -> list[Any]:
    """Return the leaves of a message; None for what registers do not carry."""
    data = struct.pack(f">{len(registers)}H", *registers)
    numbers = iter(struct.unpack(_format(kind), data))
    leaves: list[Any] = []
    for path in kind.paths:
        last = path.rpartition(".")[2]
        if last in ("frame_id", "name"):
            leaves.append(None)
        elif kind.length and last not in ("sec", "nanosec"):
            leaves.append([next(numbers) for _ in range(kind.length)])
        else:
            leaves.append(next(numbers))
    return leaves


def size(kind: Kind) -> int:
    """Return the number of registers of a message."""
    return struct.calcsize(_format(kind)) // 2


def pieces(count: int, limit: int) -> list[tuple[int, int]]:
    """Return begin and end of each request that moves ``count`` registers, ``limit`` at a time."""
    return [(begin, min(begin + limit, count)) for begin in range(0, count, limit)]
