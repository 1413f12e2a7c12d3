"""A classic topic: its lock, its memory, and both as one object that can be recreated (spec/classic-mode.md).

The lock (section 2) is a named semaphore. Nothing here ever waits: a caller tries, and tries again later. A
semaphore does not record its holder, so a holder's death can only be inferred: the semaphore was taken at
every check for a long time, and nothing changed. The time is passed in.

The memory is one bare record at offset 0. It is read and written through its descriptor: classic programs
call ftruncate on an object that others use; with a mapping, this would cause SIGBUS, regardless of earlier
checks. A copy by system call is short instead.

Calls of the C library keep the interpreter's lock (``ctypes.PyDLL``): the PLC waits while this process holds
the semaphore, and a call that releases the interpreter's lock, as those of ``os`` and posix_ipc do, gets it
back up to 5 ms later for each other busy thread. None of these calls waits.

Classic programs remove and create their objects whenever they start. Therefore, the objects held here are
compared with those that the names refer to before and after every use, and attached again if they differ.
"""

from __future__ import annotations

import ctypes
import enum
import errno
import mmap
import os
import re
import stat
import struct
from contextlib import suppress
from pathlib import Path

from rosplc.errors import ChannelError
from rosplc.shm import files
from rosplc.shm.files import USUAL, NameLock, Rights, create_complete, open_plain_file, same_file
from rosplc.shm.header import channel_error

_C = ctypes.PyDLL(None, use_errno=True)
_sem_open = _C.sem_open
_sem_open.restype = ctypes.c_void_p
_sem_open.argtypes = [ctypes.c_char_p, ctypes.c_int, ctypes.c_uint, ctypes.c_uint]
_sem_close, _sem_trywait, _sem_post = _C.sem_close, _C.sem_trywait, _C.sem_post
for _function in (_sem_close, _sem_trywait, _sem_post):
    _function.argtypes = [ctypes.c_void_p]
_sem_getvalue = _C.sem_getvalue
_sem_getvalue.argtypes = [ctypes.c_void_p, ctypes.POINTER(ctypes.c_int)]
# Of 32-bit C libraries the plain names take 32-bit offsets.
_pread, _pwrite = _C.pread64, _C.pwrite64
for _function in (_pread, _pwrite):
    _function.restype = ctypes.c_ssize_t
    _function.argtypes = [ctypes.c_int, ctypes.c_void_p, ctypes.c_size_t, ctypes.c_int64]

_lseek = _C.lseek64
_lseek.restype = ctypes.c_int64
_lseek.argtypes = [ctypes.c_int, ctypes.c_int64, ctypes.c_int]


class Semaphore:
    """The named semaphore ``/dev/shm/sem.NAME``; ``create``: with the value 1. OSError as for sem_open."""

    def __init__(self, name: str, *, create: bool = False, mode: int = 0o600) -> None:
        self._at: int | None = None
        flags = os.O_CREAT | os.O_EXCL if create else 0
        self._at = _sem_open(b"/" + os.fsencode(name), flags, mode, 1)
        if self._at is None:
            raise _error(name)

    @property
    def value(self) -> int:
        """The value: the number of processes that could enter now."""
        found = ctypes.c_int()
        _done(_sem_getvalue(self._address(), ctypes.byref(found)))
        return found.value

    def enter(self) -> bool:
        """Decrement the value if it is above 0, without waiting; return whether this succeeded."""
        if _sem_trywait(self._address()) == 0:
            return True
        if ctypes.get_errno() in (errno.EAGAIN, errno.EINTR):
            return False
        raise _error("")

    def leave(self) -> None:
        """Increment the value. Raises OSError (EOVERFLOW) if it is at its maximum."""
        _done(_sem_post(self._address()))

    def close(self) -> None:
        """Close the semaphore, which stays. A second call does nothing."""
        at, self._at = self._at, None
        if at is not None:
            _sem_close(at)

    def __del__(self) -> None:
        self.close()

    def _address(self) -> int:
        if self._at is None:
            raise ValueError("the semaphore is closed")
        return self._at


def _done(result: int) -> int:
    """Return the result of a C library function; raise OSError if it failed."""
    if result < 0:
        raise _error("")
    return result


def _error(name: str) -> OSError:
    number = ctypes.get_errno()
    return OSError(number, os.strerror(number), name or None)


SEMAPHORE_SIZE = 32 if struct.calcsize("P") == 8 else 16
"""Bytes of glibc's sem_t for programs of this word size."""

_SHARED = 128
"""The value that glibc's sem_open writes to ``private``: waiters may be in other processes."""
_LARGEST = 2**31 - 1
_LEAST_LOOKS = 20
_MOST_EXTRA = 64
_LONGEST_GAP = 4
"""Checks further apart than this fraction of the time are ignored: this process itself was stopped."""


class Entry(enum.Enum):
    """The result of an attempt to take the lock."""

    ENTERED = enum.auto()
    BUSY = enum.auto()
    RECOVERED = enum.auto()
    """The holder is no longer alive, and the lock is free now; the memory may be half written."""


class ClassicLock:
    """A semaphore that either side may have created; opened, or created with the value 1.

    ``recover_after_ns`` is as in :class:`rosplc.config.plans.ClassicPlan`. Raises ChannelError SHM128 if it
    cannot be opened, SHM133 if a program of another word size created it, SHM102 if the group of a new one
    cannot be set, SHM121 if the name does not refer to a plain file.
    """

    def __init__(
        self, name: str, recover_after_ns: int, *, rights: Rights = USUAL, directory: Path | str = "/dev/shm"
    ) -> None:
        self.name = name
        self.path = Path(directory) / f"sem.{name}"
        self.created = False
        # since when it was taken at every look without a sign of life; None if it was free
        self.held_since_ns: int | None = None
        # how often it was freed for a holder that counted as dead; how often it would have let in several
        self.recovered = self.mended = 0
        self.doubtful = False  # whether somebody may be inside without the lock: after either of the two
        self._recover_after_ns = recover_after_ns
        self._looked_ns = 0
        self._looks = 0
        self._semaphore, self._identity = self._open(rights)

    @property
    def value(self) -> int:
        """The value: 1 if the lock is free, 0 if it is taken."""
        return self._semaphore.value

    def enter(self, now_ns: int, *, alive: bool = False) -> Entry:
        """Try to take the lock; ``alive``: the holder has shown signs of life since the last attempt."""
        if not self._semaphore.enter():
            return self._taken(now_ns, alive)
        self.held_since_ns = None
        extra = 0
        # No other process should be able to enter now.
        while extra < _MOST_EXTRA and self._semaphore.value > 0 and self._semaphore.enter():
            extra += 1
        if extra:
            # Another holder is perhaps still active; this attempt has no lock to speak of.
            self.mended += 1
            self.doubtful = True
            self.leave()
            return Entry.BUSY
        return Entry.ENTERED

    def leave(self) -> None:
        """Release the lock. Raises SHM128 if the semaphore refuses this."""
        try:
            self._semaphore.leave()
        except (OSError, ValueError) as error:
            raise channel_error(128, f"cannot release the semaphore: {error}", self.path) from error

    def look(self, now_ns: int, *, alive: bool = False) -> Entry:
        """Check the lock without taking it; ``ENTERED`` means that it is free."""
        value = self._semaphore.value
        if value == 0:
            return self._taken(now_ns, alive)
        self.held_since_ns = None
        if value > 1 and self.enter(now_ns, alive=alive) is Entry.ENTERED:
            self.leave()
        return Entry.ENTERED

    def in_place(self) -> bool:
        """Return whether the name still refers to this semaphore."""
        return same_file(self.path, *self._identity)

    def close(self) -> None:
        """Close the lock; the semaphore stays. A second call does nothing."""
        self._semaphore.close()

    def _taken(self, now_ns: int, alive: bool) -> Entry:
        gap = now_ns - self._looked_ns
        self._looked_ns = now_ns
        if self.held_since_ns is None or alive or gap * _LONGEST_GAP > self._recover_after_ns:
            self.held_since_ns, self._looks = now_ns, 0
        self._looks += 1
        if now_ns - self.held_since_ns < self._recover_after_ns or self._looks < _LEAST_LOOKS:
            return Entry.BUSY
        if self._semaphore.value != 0:
            return Entry.BUSY
        # Between the look and the post the holder may leave after all. Then two could enter, which the
        # next attempt finds and mends.
        self.leave()
        self.held_since_ns = None
        self.recovered += 1
        self.doubtful = True
        return Entry.RECOVERED

    def _open(self, rights: Rights) -> tuple[Semaphore, tuple[int, int]]:
        while True:
            try:
                found = self.path.lstat()
            except FileNotFoundError:
                self._create(rights)
                continue
            except OSError as error:
                raise channel_error(123, error.strerror or "", self.path) from error
            if not stat.S_ISREG(found.st_mode):
                # A pipe would block its reader; the C library refuses links alone.
                raise channel_error(121, where=self.path)
            if found.st_size != SEMAPHORE_SIZE:
                raise _other_kind(self.path, found.st_size)
            self._refuse_nonsense()
            try:
                semaphore = Semaphore(self.name)
            except FileNotFoundError:
                continue
            except PermissionError as error:
                if found.st_uid == os.geteuid() and found.st_mode & 0o600 != 0o600:
                    # Made by this very user, who passed O_RDWR for the mode and so gave it no rights at all.
                    _open_up(self.path, found, rights.mode)
                    continue
                remedy = (
                    "Run the bridge as the user that created the semaphore, or set shm.group to a common "
                    "group and start the bridge first."
                )
                raise _denied("SHM128", "semaphore", self.path, remedy) from error
            except OSError as error:
                raise channel_error(128, f"cannot open the semaphore: {error.strerror}", self.path) from error
            # The library does not tell which file it opened; a name that did not change tells it.
            if same_file(self.path, found.st_dev, found.st_ino):
                return semaphore, (found.st_dev, found.st_ino)
            semaphore.close()

    def _refuse_nonsense(self) -> None:
        """Refuse a file that is not a semaphore: with invalid content, glibc would abort the process."""
        try:
            fd = open_plain_file(self.path, os.O_RDONLY)
        except ChannelError:
            return  # gone, or not readable: opening it reports that
        try:
            content = os.pread(fd, SEMAPHORE_SIZE + 1, 0)
        finally:
            os.close(fd)
        if len(content) != SEMAPHORE_SIZE:
            raise _other_kind(self.path, len(content))
        value, shared = struct.unpack_from("=IxxxxI" if SEMAPHORE_SIZE == 32 else "=II", content)
        if shared != _SHARED or value > _LARGEST:
            raise channel_error(128, "the content of the file is not a semaphore", self.path)

    def _create(self, rights: Rights) -> None:
        try:
            made = Semaphore(self.name, create=True, mode=rights.mode)
        except FileExistsError:
            return
        except OSError as error:
            raise channel_error(128, f"cannot create the semaphore: {error.strerror}", self.path) from error
        made.close()
        self.created = True
        try:
            fd = open_plain_file(self.path, os.O_RDWR)
        except ChannelError:
            return  # replaced at this moment: the other side's is as good, or opening it reports why not
        try:
            if os.fstat(fd).st_uid == os.geteuid():
                rights.give(fd, self.path)
        finally:
            os.close(fd)


def _open_up(path: Path, found: os.stat_result, mode: int) -> None:
    """Set the mode of a file that cannot be opened, but never of another file that has taken its name."""
    with suppress(FileNotFoundError):
        fd = os.open(path, os.O_PATH | os.O_NOFOLLOW | os.O_CLOEXEC)
        try:
            if os.path.samestat(os.fstat(fd), found):
                Path(f"/proc/self/fd/{fd}").chmod(mode)
        finally:
            os.close(fd)


def _other_kind(path: Path, size: int) -> ChannelError:
    if size in (16, 32):
        bits, here = size * 2, SEMAPHORE_SIZE * 2
        what = f"a {bits}-bit program created the semaphore, but this is a {here}-bit process"
        return channel_error(133, what, path)
    return channel_error(128, f"the file has {size} bytes, but a semaphore has {SEMAPHORE_SIZE}", path)


_TEMPORARY = re.compile(r"rosplc\.new\.[0-9a-f]{8,16}")


class ClassicMemory:
    """An object that either side may have created; opened or created. Without ``write``, reading suffices.

    Raises ChannelError SHM129 if it is smaller than the record, SHM102 without the rights, SHM117 without
    room for a new one, SHM121 if the name does not refer to a plain file or the file has hard links, SHM123
    without a directory.
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
                    remedy = (
                        "Only root can use the objects of a PLC runtime that runs as root: run the bridge as "
                        "the runtime's user, or set shm.group to a common group and start the bridge "
                        "first."
                    )
                    raise _denied("SHM102", "memory", path, remedy) from error
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
        """Whether it is larger than the record by more than rounding to pages explains."""
        return self.size > self.record_size and self.size % mmap.PAGESIZE != 0

    def read(self) -> bytes:
        """Return the record. Raises SHM129 if the object has become too small."""
        done = _done(_pread(self._fd, self._buffer, self.record_size, 0))
        if done < self.record_size:
            self._large_enough(done)
        return self._buffer.raw

    def write(self, record: bytes) -> None:
        """Write the record. Raises SHM129 if the object has become too small, SHM117 without room."""
        # A write beyond the end would make it grow again after it was cut.
        self._large_enough(_done(_lseek(self._fd, 0, os.SEEK_END)))
        if _done(_pwrite(self._fd, record, len(record), 0)) != len(record):
            raise channel_error(117, "a record was only partly written", self.path)

    def in_place(self) -> bool:
        """Return whether the name still refers to this object."""
        return same_file(self.path, *self.identity)

    def close(self) -> None:
        """Close the memory; the object stays. A second call does nothing."""
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
        what = f"the memory has {size} bytes, but the record needs {self.record_size}"
        if not size:
            what = f"the memory is empty (created without a size), but the record needs {self.record_size}"
        raise channel_error(129, what, self.path)


def _remove_own_leftover(directory: Path, identity: tuple[int, int]) -> None:
    """Remove the temporary name of an object whose creator was killed just after giving it its final name."""
    for name in directory.glob("rosplc.new.*"):
        if _TEMPORARY.fullmatch(name.name) and same_file(name, *identity):
            with suppress(OSError):
                name.unlink()


def _denied(code: str, thing: str, path: Path, remedy: str) -> ChannelError:
    what = f"the {thing} ({files.describe_owner(path)}) is not accessible to user {os.geteuid()}"
    return ChannelError(code, what, where=str(path), remedy=remedy)


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
        """How often the lock was freed for a dead holder."""
        return self._counted[0] + (self.lock.recovered if self.lock else 0)

    @property
    def mended(self) -> int:
        """How often the lock would have admitted more than one holder."""
        return self._counted[1] + (self.lock.mended if self.lock else 0)

    @property
    def doubtful(self) -> bool:
        """Whether another program may access the memory at the same time; always True without a lock."""
        return self.lock is None or self.lock.doubtful

    def claim(self) -> None:
        """Exclude other bridges from this memory, regardless of prefix; raises as :class:`NameLock`."""
        path = self._directory / f"rosplc.classic.{self.name}"
        self._claim = NameLock(path, self._rights)

    def owned(self) -> bool:
        """Return whether the claim of :meth:`claim` still holds."""
        return self._claim is not None and self._claim.still_there()

    def attach(self) -> None:
        """Open the memory and semaphore, and create what is missing; raises as their classes do."""
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
        """Return whether both names still refer to the objects held here."""
        if self.memory is None:
            return False
        return self.memory.in_place() and (self.lock is None or self.lock.in_place())

    def enter(self, now_ns: int, *, alive: bool = False) -> Entry:
        """Try to take the lock; without a semaphore, this always succeeds."""
        return self.lock.enter(now_ns, alive=alive) if self.lock else Entry.ENTERED

    def look(self, now_ns: int, *, alive: bool = False) -> Entry:
        """Check the lock without taking it."""
        return self.lock.look(now_ns, alive=alive) if self.lock else Entry.ENTERED

    def leave(self) -> None:
        """Release the lock."""
        if self.lock:
            self.lock.leave()

    def read(self) -> bytes | None:
        """Return the record, read while holding the lock, twice if in doubt; None if a writer was seen."""
        assert self.memory is not None
        image = self.memory.read()
        return None if self.doubtful and self.memory.read() != image else image

    def peek(self) -> bytes:
        """Return the current record, which may be half written, to detect changes."""
        assert self.memory is not None
        return self.memory.read()

    def write(self, record: bytes) -> None:
        """Write the record; call this while holding the lock."""
        assert self.memory is not None
        self.memory.write(record)

    def detach(self) -> None:
        """Close memory and lock; both stay."""
        lock, self.lock = self.lock, None
        if lock is not None:
            recovered, mended = self._counted
            self._counted = (recovered + lock.recovered, mended + lock.mended)
            lock.close()
        memory, self.memory = self.memory, None
        if memory is not None:
            memory.close()

    def close(self) -> None:
        """Detach and release the claim; a second call does nothing."""
        self.detach()
        claim, self._claim = self._claim, None
        if claim is not None:
            with suppress(OSError):
                claim.release()
