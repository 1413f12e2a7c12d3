"""What a fuzzer has done so far, in a file that it maps: the one that kills it still knows.

The file is a row of little-endian 64-bit words: executions, bytes, and, for targets that count
kinds of input, one word for each kind.
"""

from __future__ import annotations

import mmap
import struct
from dataclasses import dataclass
from pathlib import Path

__all__ = ["Counter", "Counts", "new_counts", "read_counts"]

_HEAD = struct.Struct("<QQ")


@dataclass(frozen=True)
class Counts:
    """Executions, bytes of their inputs, and how often each kind of input was tried."""

    executions: int = 0
    bytes: int = 0
    kinds: tuple[int, ...] = ()


def new_counts(path: Path, kinds: int = 0) -> None:
    """Create the file, with everything at 0."""
    path.write_bytes(bytes(_HEAD.size + 8 * kinds))


def read_counts(path: Path) -> Counts:
    """Return what the file says now."""
    data = path.read_bytes()
    executions, size = _HEAD.unpack_from(data)
    return Counts(
        executions, size, struct.unpack_from(f"<{(len(data) - _HEAD.size) // 8}Q", data, _HEAD.size)
    )


class Counter:
    """The file as its fuzzer sees it.

    Args:
        path: A file that :func:`new_counts` made.
    """

    def __init__(self, path: Path) -> None:
        with path.open("r+b") as file:
            self._memory = mmap.mmap(file.fileno(), 0)
        self._executions, self._bytes = _HEAD.unpack_from(self._memory)

    def add(self, size: int) -> None:
        """Count an execution on an input of ``size`` bytes."""
        self._executions += 1
        self._bytes += size
        _HEAD.pack_into(self._memory, 0, self._executions, self._bytes)
