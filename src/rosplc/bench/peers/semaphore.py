"""The source's design with posix_ipc: shared memory, a semaphore as its lock, and looking again."""

from __future__ import annotations

import mmap
import os
from pathlib import Path

import posix_ipc

from rosplc.bench.peers.exchange import COUNT, Transport, serve

__all__ = ["LockedMemory", "main"]

_SIZE = 2 * COUNT
_PAGE = 4096


class LockedMemory(Transport):
    """One area of memory and one lock for each direction.

    Args:
        side: "A" or "B".
        file: The areas: A's in the first page, B's in the second.
        names: The locks: A's, B's.
    """

    def __init__(self, side: str, file: Path, names: tuple[str, str]) -> None:
        super().__init__()
        descriptor = os.open(file, os.O_RDWR | os.O_CREAT, 0o600)
        os.ftruncate(descriptor, 2 * _PAGE)
        self._memory = mmap.mmap(descriptor, 2 * _PAGE)
        os.close(descriptor)
        me = side == "B"
        view = memoryview(self._memory)
        areas = [view[:_SIZE], view[_PAGE : _PAGE + _SIZE]]
        areas[me][:] = b"\xff" * _SIZE  # nothing that a first message could be equal to
        locks = [posix_ipc.Semaphore(name, posix_ipc.O_CREAT, mode=0o600, initial_value=1) for name in names]
        self._out, self._in = areas[me], areas[not me]
        self._out_lock, self._in_lock = locks[me], locks[not me]
        self._seen = b"\xff" * _SIZE

    def send(self, record: bytearray) -> None:
        """Copy the record in, under the lock."""
        self._out_lock.acquire()
        self._out[:] = record
        self._out_lock.release()

    def attempt(self, record: bytearray) -> bool:
        """Copy it out, under the lock; it is new if it differs."""
        self._in_lock.acquire()
        found = self._in.tobytes()
        self._in_lock.release()
        if found == self._seen:
            return False
        self._seen = found
        record[:] = found
        return True


def main(side: str, arguments: list[str]) -> None:
    """Arguments: the file, and the names of two semaphores."""
    file, *names = arguments
    serve(side, LockedMemory(side, Path(file), (names[0], names[1])))
