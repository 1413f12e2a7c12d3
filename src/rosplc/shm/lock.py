"""The lock that makes a bridge the owner of a name: spec/shm-format.md, section 8.2."""

from __future__ import annotations

import fcntl
import os
import time
from pathlib import Path

from rosplc.errors import ChannelError
from rosplc.shm.files import Rights, open_plain_file, refuse_second_name, same_file, user_name
from rosplc.shm.header import channel_error


class NameLock:
    """An exclusive flock on a name's lock file, held until :meth:`release`.

    The kernel drops it when the process dies, however that happens. The file itself stays: a removed lock
    file would let two bridges hold "the" lock. Its size is one bit of memory: 1 once an object of a bridge
    has been at the name, 0 before and after that was retired. Its time of change is when a holder was last
    seen. The file gets the object's mode and group; ``rights.uid``, this process's user and root may own an
    older one.

    Raises ChannelError SHM116 if another bridge holds it, SHM119 if the file is another user's, SHM102 if it
    cannot be given to the group, SHM121 if it is no plain file or a hard link, SHM123 if the directory cannot
    be used.
    """

    def __init__(self, path: Path, rights: Rights) -> None:
        self.path = path
        self.unheld_ns = 0  # for how long nothing had held the lock before, ns; 0 where that is not known
        self._fd = -1
        while True:
            fd = _open_or_create(path)
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
            self._refuse_foreign(rights.uid)
            self._share(rights.mode & 0o666, rights.gid)
            status = os.fstat(self._fd)
            if status.st_size:  # an object has been there, and so has a holder
                self.unheld_ns = max(0, time.time_ns() - status.st_mtime_ns)
        except OSError as error:
            self.release()
            what = f"cannot give the lock file to group {rights.gid}: {error.strerror}"
            raise channel_error(102, what, str(path)) from error
        except BaseException:
            self.release()
            raise

    @property
    def held_an_object(self) -> bool:
        """Whether a bridge has put an object at the name before, and not retired it."""
        return os.fstat(self._fd).st_size > 0

    def remember_object(self, there: bool) -> None:
        """Note that an object of this bridge stands at the name, or that it was retired."""
        # A size without content takes no page of a directory that may be full.
        os.ftruncate(self._fd, 1 if there else 0)

    def _refuse_foreign(self, uid: int | None) -> None:
        refuse_second_name(self._fd, self.path)
        owner = os.fstat(self._fd).st_uid
        # An owner may remove the file, and with it the lock, at any time.
        if owner not in (0, os.geteuid(), uid):
            raise channel_error(119, f"the lock file is user {user_name(owner)}'s", str(self.path))

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

    def show(self) -> None:
        """Note in the file's time stamp that the lock is held now; about once a second."""
        if self._fd >= 0:
            os.utime(self._fd)

    def release(self) -> None:
        """Let go; a second call does nothing."""
        if self._fd >= 0:
            os.close(self._fd)
            self._fd = -1

    def __del__(self) -> None:
        # A descriptor is a plain number: one that nobody closes keeps the name until the process ends.
        self.release()


def _open_or_create(path: Path) -> int:
    # Never O_CREAT on what exists: with fs.protected_regular the kernel refuses that for another user's
    # file in a directory like /dev/shm, to root too, and says no more than "permission denied".
    while True:
        for flags in (0, os.O_CREAT | os.O_EXCL):
            try:
                return open_plain_file(path, os.O_RDWR | flags, denied=119)
            except ChannelError as error:
                if error.code != "SHM101" and not isinstance(error.__cause__, FileExistsError):
                    raise
