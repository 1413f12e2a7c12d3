"""A read-only look at a classic topic's memory and lock, which cannot describe themselves.

The lock is not taken: whoever looks must not be able to make a PLC wait. A record read so may be
half written, and is read until two reads agree.
"""

from __future__ import annotations

import os
import struct
from dataclasses import dataclass
from pathlib import Path

from rosplc.errors import ChannelError
from rosplc.shm.classic_memory import ClassicMemory
from rosplc.shm.who import describe_owner

__all__ = ["ClassicState", "look_at"]

_ATTEMPTS = 100


@dataclass(frozen=True)
class ClassicState:
    """Memory and lock as they stand.

    Attributes:
        name: The memory's name.
        semaphore: The semaphore's name; empty if there is none by configuration.
        size: Bytes of the memory; 0 while there is none.
        owner: Its owner and mode, ``root:root 0750``.
        value: How many could enter now: 1 if the lock is free, 0 if it is taken; None if there is
            no semaphore or it cannot be read.
        record: The record; None if it cannot be read.
        error: Why it cannot be read; empty if it can.
        code: The error's code.
    """

    name: str
    semaphore: str
    size: int = 0
    owner: str = ""
    value: int | None = None
    record: bytes | None = None
    error: str = ""
    code: str = ""

    @property
    def lock(self) -> str:
        """The lock in a word."""
        if not self.semaphore:
            return "none"
        if self.value is None:
            return "not readable" if Path(f"/dev/shm/sem.{self.semaphore}").exists() else "missing"
        return {0: "taken", 1: "free"}.get(self.value, f"lets in {self.value}")


def look_at(name: str, semaphore: str, record_size: int) -> ClassicState:
    """Return how a classic topic's memory and lock stand; what is missing stands in ``error``.

    Args:
        name: The memory's name.
        semaphore: The semaphore's name; empty if there is none.
        record_size: Bytes of the record.
    """
    path = Path("/dev/shm") / name
    value = _value(semaphore) if semaphore else None
    if not os.path.lexists(path):
        return ClassicState(name, semaphore, value=value, error="there is no such memory", code="SHM101")
    try:
        with ClassicMemory(path, record_size, write=False) as memory:
            record = memory.read()
            for _ in range(_ATTEMPTS):
                again = memory.read()
                if again == record:
                    break
                record = again
            return ClassicState(name, semaphore, memory.size, describe_owner(path), value, record)
    except ChannelError as error:
        size = path.stat().st_size if path.exists() else 0
        return ClassicState(
            name, semaphore, size, describe_owner(path), value, error=error.what, code=error.code
        )


def _value(semaphore: str) -> int | None:
    try:
        content = (Path("/dev/shm") / f"sem.{semaphore}").read_bytes()
    except OSError:
        return None
    if len(content) == 32:
        return int(struct.unpack_from("=I", content)[0])
    # 32-bit programs keep a flag for waiters in the lowest bit.
    return int(struct.unpack_from("=I", content)[0]) >> 1 if len(content) == 16 else None
