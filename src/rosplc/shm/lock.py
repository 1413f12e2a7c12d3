"""The lock that makes a bridge the owner of a name: spec/shm-format.md, section 8.2."""

from __future__ import annotations

import fcntl
import os
from pathlib import Path

from rosplc.shm.files import open_plain_file, same_file
from rosplc.shm.header import channel_error

__all__ = ["NameLock"]


class NameLock:
    """An exclusive flock on a name's lock file, held until :meth:`release`.

    The kernel drops it when the process dies, however that happens. The file itself stays: a
    removed lock file would let two bridges hold "the" lock.

    Raises:
        ChannelError: SHM116 if another bridge holds it, SHM119 if the file is another user's,
            SHM102 if it cannot be given to the group, SHM121 if it is no plain file, SHM123 if the
            directory cannot be used.
    """

    def __init__(self, path: Path, *, mode: int, gid: int | None = None) -> None:
        self.path = path
        self._fd = -1
        while True:
            fd = open_plain_file(path, os.O_RDWR | os.O_CREAT, denied=119)
            try:
                fcntl.flock(fd, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError as error:
                os.close(fd)
                raise channel_error(116, where=str(path)) from error
            except BaseException:
                os.close(fd)
                raise
            self._fd = fd
            # Whoever removed the file between open and flock left us with a lock on nothing.
            if self.still_there():
                break
            self.release()
        try:
            self._share(mode & 0o666, gid)
        except OSError as error:
            self.release()
            what = f"cannot give the lock file to group {gid}: {error.strerror}"
            raise channel_error(102, what, str(path)) from error

    def _share(self, mode: int, gid: int | None) -> None:
        status = os.fstat(self._fd)
        if status.st_uid == os.geteuid():
            if gid is not None and status.st_gid != gid:
                os.fchown(self._fd, -1, gid)
            os.fchmod(self._fd, mode)

    def still_there(self) -> bool:
        """Return whether the lock is held and the name still leads to the file that is locked."""
        if self._fd < 0:
            return False
        mine = os.fstat(self._fd)
        return same_file(self.path, mine.st_dev, mine.st_ino)

    def release(self) -> None:
        """Let go; a second call does nothing."""
        if self._fd >= 0:
            os.close(self._fd)
            self._fd = -1

    def __del__(self) -> None:
        # A descriptor is a plain number: one that nobody closes keeps the name until the process ends.
        self.release()
