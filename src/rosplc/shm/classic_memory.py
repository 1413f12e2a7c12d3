"""The memory of a classic topic: one bare record at offset 0 (spec/classic-mode.md, section 1).

It is read and written through its descriptor, not through a mapping: peers of this kind call
ftruncate on an object that others use, and a mapping would answer that with SIGBUS, whatever was
checked before. A copy by system call comes back short instead.
"""

from __future__ import annotations

import ctypes
import mmap
import os
import re
from contextlib import suppress
from pathlib import Path

from rosplc.errors import ChannelError
from rosplc.shm.files import (
    USUAL,
    Rights,
    create_complete,
    describe_owner,
    open_plain_file,
    refuse_second_name,
    same_file,
)
from rosplc.shm.header import channel_error
from rosplc.shm.semaphore import read_at, size_of, write_at

__all__ = ["ClassicMemory"]

_TEMPORARY = re.compile(r"rosplc\.new\.[0-9a-f]{8,16}")


class ClassicMemory:
    """An object that either side may have made, opened or created.

    Args:
        write: Whether it is written too; without it rights to read are enough.
        rights: Of a new one.

    Attributes:
        created: Whether it was made here.
        identity: Device and inode of its file.
        size: Bytes that it had when it was opened.

    Raises:
        ChannelError: SHM129 if it is smaller than the record, SHM102 without the rights, SHM117 without
            room for a new one, SHM121 if the name leads to no plain file or to a hard link, SHM123 without
            a directory.
    """

    def __init__(
        self,
        path: Path,
        record_size: int,
        *,
        write: bool = True,
        rights: Rights = USUAL,
    ) -> None:
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
            self.size = found.st_size
            if found.st_nlink > 1:
                _remove_own_leftover(path.parent, self.identity)
            refuse_second_name(self._fd, path)
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
        # A write beyond the end would make it grow again under the hands of whoever cut it.
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
            what = f"the memory is empty (whoever made it gave it no size), the record has {self.record_size}"
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
        f"the memory is {describe_owner(path)}, and this process is user {os.geteuid()}",
        where=str(path),
        remedy="Objects of a PLC runtime that runs as root are closed to others: run the bridge as the "
        "runtime's user, or start it first and give the object to a common group with shm.group.",
    )
