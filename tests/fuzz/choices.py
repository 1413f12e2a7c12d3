"""Bytes as decisions, so that one input can have several parts."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TypeVar

__all__ = ["Choices"]

T = TypeVar("T")


class Choices:
    """Reads decisions off the front of an input; an exhausted one decides 0 and nothing.

    Args:
        data: The input.
    """

    def __init__(self, data: bytes) -> None:
        self._data = data
        self._at = 0

    def __bool__(self) -> bool:
        return self._at < len(self._data)

    def byte(self) -> int:
        """Return the next byte."""
        self._at += 1
        return self._data[self._at - 1] if self._at <= len(self._data) else 0

    def number(self, size: int = 4) -> int:
        """Return an unsigned number of so many bytes."""
        return int.from_bytes(self.take(size), "little")

    def below(self, end: int) -> int:
        """Return a number from 0 to ``end`` - 1, at most 255."""
        return self.byte() % end

    def flag(self) -> bool:
        """Return yes or no."""
        return bool(self.byte() & 1)

    def pick(self, options: Sequence[T]) -> T:
        """Return one of at most 256 options."""
        return options[self.below(len(options))]

    def take(self, size: int) -> bytes:
        """Return so many bytes, fewer at the end."""
        part = self._data[self._at : self._at + size]
        self._at += size
        return part

    def part(self) -> bytes:
        """Return the bytes up to a 0xFF (which no UTF-8 has), or all that are left."""
        found = self._data.find(b"\xff", self._at)
        end = len(self._data) if found < 0 else found
        part = self._data[self._at : end]
        self._at = end + 1
        return part

    def text(self) -> str:
        """Return :meth:`part` as text; what is no UTF-8 becomes surrogates, as it does in JSON and paths."""
        return self.part().decode("utf-8", "surrogateescape")

    def rest(self) -> bytes:
        """Return all that is left."""
        part = self._data[self._at :]
        self._at = len(self._data)
        return part
