"""Named semaphores and copies of the C library, called without letting another thread in between.

Whoever holds the lock of a classic memory keeps a PLC waiting. A call that gives up the interpreter's
lock, as those of ``os`` and of posix_ipc do, gets it back up to 5 ms later for each other busy
thread: so long the semaphore would stay taken. ``ctypes.PyDLL`` keeps it. None of these calls waits.
"""

from __future__ import annotations

import ctypes
import errno
import os

__all__ = ["Semaphore", "read_at", "size_of", "write_at"]

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
    """A named semaphore; ``/dev/shm/sem.NAME`` on Linux.

    Args:
        name: Without a slash.
        create: Make it, with the value 1; it must not be there yet. Otherwise open it.
        mode: Permission bits of a new one, less the process's umask.

    Raises:
        OSError: As sem_open says: FileNotFoundError, FileExistsError, PermissionError, …
    """

    def __init__(self, name: str, *, create: bool = False, mode: int = 0o600) -> None:
        self._at: int | None = None
        flags = os.O_CREAT | os.O_EXCL if create else 0
        self._at = _sem_open(b"/" + os.fsencode(name), flags, mode, 1)
        if self._at is None:
            raise _error(name)

    @property
    def value(self) -> int:
        """How many could enter now."""
        found = ctypes.c_int()
        if _sem_getvalue(self._address(), ctypes.byref(found)):
            raise _error("")
        return found.value

    def enter(self) -> bool:
        """Take one if there is one, at once; return whether there was."""
        if _sem_trywait(self._address()) == 0:
            return True
        if ctypes.get_errno() in (errno.EAGAIN, errno.EINTR):
            return False
        raise _error("")

    def leave(self) -> None:
        """Give one back. Raises OSError (EOVERFLOW) if there are too many."""
        if _sem_post(self._address()):
            raise _error("")

    def close(self) -> None:
        """Let go of it; it stays. A second call does nothing."""
        at, self._at = self._at, None
        if at is not None:
            _sem_close(at)

    def __del__(self) -> None:
        self.close()

    def _address(self) -> int:
        if self._at is None:
            raise ValueError("the semaphore is closed")
        return self._at


def read_at(fd: int, buffer: ctypes.Array[ctypes.c_char]) -> int:
    """Copy from the beginning of a file into a buffer; return how many bytes there were."""
    done: int = _pread(fd, buffer, len(buffer), 0)
    if done < 0:
        raise _error("")
    return done


def size_of(fd: int) -> int:
    """Return a file's size."""
    size: int = _lseek(fd, 0, os.SEEK_END)
    if size < 0:
        raise _error("")
    return size


def write_at(fd: int, content: bytes) -> int:
    """Copy bytes to the beginning of a file; return how many were written."""
    done: int = _pwrite(fd, content, len(content), 0)
    if done < 0:
        raise _error("")
    return done


def _error(name: str) -> OSError:
    number = ctypes.get_errno()
    return OSError(number, os.strerror(number), name or None)
