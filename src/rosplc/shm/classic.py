"""A classic topic's memory, and memory and lock as one thing that comes and goes: spec/classic-mode.md.

The memory is one bare record at offset 0. It is read and written through its descriptor: peers of this kind
call ftruncate on an object that others use, and a mapping would answer that with SIGBUS, whatever was checked
before. A copy by system call comes back short instead.

Programs of this kind remove and make their objects whenever they start. What is held here is therefore
compared with what the names lead to before and after every use, and attached again.
"""

from __future__ import annotations

import ctypes
import mmap
import os
import re
from contextlib import suppress
from pathlib import Path

from rosplc.errors import ChannelError
from rosplc.shm import files
from rosplc.shm.classic_lock import ClassicLock, Entry, read_at, size_of, write_at
from rosplc.shm.files import USUAL, Rights, create_complete, open_plain_file, same_file
from rosplc.shm.header import channel_error
from rosplc.shm.lock import NameLock

_TEMPORARY = re.compile(r"rosplc\.new\.[0-9a-f]{8,16}")


class ClassicMemory:
    """An object that either side may have made, opened or created; read rights suffice without ``write``.

    Raises ChannelError SHM129 if it is smaller than the record, SHM102 without the rights, SHM117 without
    room for a new one, SHM121 if the name leads to no plain file or to a hard link, SHM123 without a
    directory.
    """

    def __init__(self, path: Path, record_size: int, *, write: bool = True, rights: Rights = USUAL) -> None:
        self.path = path
        self.record_size = record_size
        self.created = False
        self._buffer = ctypes.create_string_buffer(record_size)
        self._fd = -1
        flags = os.O_RDWR if write else os.O_RDONLY
        while self._fd < 0:
            try:
                self._fd = open_plain_file(path, flags)
            except ChannelError as error:
                if error.code == "SHM102":
                    raise _denied(path) from error
                if error.code != "SHM101":
                    raise
                try:
                    self._fd = create_complete(path, "rosplc.new.", b"", record_size, rights, replace=False)
                    self.created = True
                except FileExistsError:
                    continue  # somebody else was faster
        try:
            found = os.fstat(self._fd)
            self.identity = found.st_dev, found.st_ino
            self.size = found.st_size  # bytes when it was opened
            if found.st_nlink > 1:
                _remove_own_leftover(path.parent, self.identity)
            files.refuse_second_name(self._fd, path)
            self._large_enough(found.st_size)
        except BaseException:
            self.close()
            raise

    @property
    def odd_size(self) -> bool:
        """Whether it is larger than the record by something else than a rounding to pages."""
        return self.size > self.record_size and self.size % mmap.PAGESIZE != 0

    def read(self) -> bytes:
        """Return the record. Raises SHM129 if the object has become too small."""
        done = read_at(self._fd, self._buffer)
        if done < self.record_size:
            self._large_enough(done)
        return self._buffer.raw

    def write(self, record: bytes) -> None:
        """Write the record. Raises SHM129 if the object has become too small, SHM117 without room."""
        # A write beyond the end would make it grow again after it was cut.
        self._large_enough(size_of(self._fd))
        if write_at(self._fd, record) != len(record):
            raise channel_error(117, "a record was written in part", str(self.path))

    def in_place(self) -> bool:
        """Return whether the name still leads to this object."""
        return same_file(self.path, *self.identity)

    def close(self) -> None:
        """Let go of it; the object stays. A second call does nothing."""
        if self._fd >= 0:
            os.close(self._fd)
            self._fd = -1

    def __enter__(self) -> ClassicMemory:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _large_enough(self, size: int) -> None:
        if size >= self.record_size:
            return
        what = f"the memory has {size} bytes, the record {self.record_size}"
        if not size:
            what = f"the memory is empty (it was created without a size), the record has {self.record_size}"
        raise channel_error(129, what, str(self.path))


def _remove_own_leftover(directory: Path, identity: tuple[int, int]) -> None:
    """Remove the temporary name of an object whose creator was killed between giving it its name and this."""
    for name in directory.glob("rosplc.new.*"):
        if _TEMPORARY.fullmatch(name.name) and same_file(name, *identity):
            with suppress(OSError):
                name.unlink()


def _denied(path: Path) -> ChannelError:
    return ChannelError(
        "SHM102",
        f"the memory is {files.describe_owner(path)}, and this process is user {os.geteuid()}",
        where=str(path),
        remedy="Objects of a PLC runtime that runs as root are closed to others: run the bridge as the "
        "runtime's user, or start it first and give the object to a common group with shm.group.",
    )


class ClassicObject:
    """The memory of one classic topic with its lock; used by one thread."""

    def __init__(
        self,
        name: str,
        semaphore: str,
        record_size: int,
        *,
        write: bool,
        recover_after_ns: int,
        rights: Rights = USUAL,
        directory: Path | str = "/dev/shm",
    ) -> None:
        # the semaphore's name is without ``sem.``, and empty if nothing guards the memory
        self.name, self.semaphore, self.record_size = name, semaphore, record_size
        self.memory: ClassicMemory | None = None
        self.lock: ClassicLock | None = None  # None while it is not attached, and without a semaphore
        self.attachments = 0  # how often it was attached
        self._directory = Path(directory)
        self._write = write
        self._recover_after_ns = recover_after_ns
        self._rights = rights
        self._claim: NameLock | None = None
        self._counted = (0, 0)

    @property
    def recovered(self) -> int:
        """How often a lock was freed."""
        return self._counted[0] + (self.lock.recovered if self.lock else 0)

    @property
    def mended(self) -> int:
        """How often a lock would have let in more than one."""
        return self._counted[1] + (self.lock.mended if self.lock else 0)

    @property
    def doubtful(self) -> bool:
        """Whether somebody may be in the memory at the same time: without a lock always."""
        return self.lock is None or self.lock.doubtful

    def claim(self) -> None:
        """Keep other bridges away from this memory, whatever their prefix; raises as its lock does."""
        path = self._directory / f"rosplc.classic.{self.name}"
        self._claim = NameLock(path, self._rights)

    def owned(self) -> bool:
        """Return whether the claim of :meth:`claim` still holds."""
        return self._claim is not None and self._claim.still_there()

    def attach(self) -> None:
        """Open memory and semaphore, and make what is missing; raises as their classes do."""
        self.detach()
        place, given = self._directory, self._rights
        memory = ClassicMemory(place / self.name, self.record_size, write=self._write, rights=given)
        try:
            if self.semaphore:
                patience = self._recover_after_ns
                self.lock = ClassicLock(self.semaphore, patience, rights=given, directory=place)
        except BaseException:
            memory.close()
            raise
        self.memory = memory
        self.attachments += 1

    def in_place(self) -> bool:
        """Return whether both names still lead to what is held here."""
        if self.memory is None:
            return False
        return self.memory.in_place() and (self.lock is None or self.lock.in_place())

    def enter(self, now_ns: int, *, alive: bool = False) -> Entry:
        """Try to take the lock; without a semaphore that succeeds."""
        return self.lock.enter(now_ns, alive=alive) if self.lock else Entry.ENTERED

    def look(self, now_ns: int, *, alive: bool = False) -> Entry:
        """Judge the lock without using it."""
        return self.lock.look(now_ns, alive=alive) if self.lock else Entry.ENTERED

    def leave(self) -> None:
        """Give the lock back."""
        if self.lock:
            self.lock.leave()

    def read(self) -> bytes | None:
        """Return the record, read inside the lock, twice if that is in doubt; None if a writer was seen."""
        assert self.memory is not None
        image = self.memory.read()
        return None if self.doubtful and self.memory.read() != image else image

    def peek(self) -> bytes:
        """Return the record as it stands, perhaps half written: to see that something changed."""
        assert self.memory is not None
        return self.memory.read()

    def write(self, record: bytes) -> None:
        """Write the record; to be called inside the lock."""
        assert self.memory is not None
        self.memory.write(record)

    def detach(self) -> None:
        """Let go of memory and lock; they stay."""
        lock, self.lock = self.lock, None
        if lock is not None:
            recovered, mended = self._counted
            self._counted = (recovered + lock.recovered, mended + lock.mended)
            lock.close()
        memory, self.memory = self.memory, None
        if memory is not None:
            memory.close()

    def close(self) -> None:
        """Detach and give the claim back; a second call does nothing."""
        self.detach()
        claim, self._claim = self._claim, None
        if claim is not None:
            with suppress(OSError):
                claim.release()
