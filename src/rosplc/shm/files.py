"""Opening, creating and locking files in the directory of shared memory: spec/shm-format.md, 8.2 and 9."""

from __future__ import annotations

import errno
import fcntl
import grp
import os
import pwd
import secrets
import stat
import time
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

from rosplc.errors import ChannelError
from rosplc.shm.constants import HEADER_SIZE
from rosplc.shm.header import channel_error

_NO_PLAIN_FILE = {
    # The kernel's text for these ("too many levels of symbolic links") is about something else.
    errno.ELOOP: "a symbolic link has this name",
    errno.EISDIR: "a directory has this name",
    errno.ENXIO: "a socket or pipe has this name",
}
_NO_ROOM = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.ENOMEM)
_ATTEMPTS = 16


@dataclass(frozen=True)
class Rights:
    """Permission bits, owner and group of created files; None for those of this process."""

    mode: int = 0o660
    uid: int | None = None
    gid: int | None = None

    @classmethod
    def of(cls, found: os.stat_result) -> Rights:
        """Return the rights of a file."""
        return cls(stat.S_IMODE(found.st_mode), found.st_uid, found.st_gid)

    def give(self, fd: int, path: Path) -> None:
        """Set the rights. Raises SHM102 if this is not permitted."""
        try:
            if self.uid is not None or self.gid is not None:
                os.fchown(fd, -1 if self.uid is None else self.uid, -1 if self.gid is None else self.gid)
            os.fchmod(fd, self.mode)
        except PermissionError as error:
            given = (("owner", self.uid), ("group", self.gid))
            wanted = [f"{word} {number}" for word, number in given if number is not None]
            what = f"cannot set {', '.join([*wanted, f'mode {self.mode:04o}'])}"
            raise channel_error(102, what, path) from error


USUAL = Rights()


def open_plain_file(path: Path, flags: int, *, denied: int = 102, mode: int = 0o600) -> int:
    """Open a plain file, never a link, a device or a pipe, and return its descriptor.

    Raises SHM101 if there is none, SHM121 if it is not a plain file, SHM123 if the directory cannot be used,
    SHM117 without room for a new file, or ``denied`` if access is denied.
    """
    try:
        # Without O_NONBLOCK a pipe of this name would stop the caller for ever.
        fd = os.open(path, flags | os.O_NOFOLLOW | os.O_CLOEXEC | os.O_NONBLOCK, mode)
    except OSError as error:
        raise _opening_error(error, path, flags, denied) from error
    if not stat.S_ISREG(os.fstat(fd).st_mode):
        os.close(fd)
        raise channel_error(121, where=path)
    return fd


def refuse_second_name(fd: int, path: Path) -> None:
    """Refuse (SHM121) a file that has other names, too, before anything in it is changed.

    A user who may create names in the directory can link the name of an object to a file that they may not
    write (if fs.protected_hardlinks is off). Objects and lock files have one name each.
    """
    count = os.fstat(fd).st_nlink
    if count > 1:
        what = f"the file has {count} names (hard links)"
        remedy = f"`find {path.parent} -samefile {path}` lists all names; remove all but the correct one."
        raise ChannelError("SHM121", what, where=str(path), remedy=remedy)


def _opening_error(error: OSError, path: Path, flags: int, denied: int) -> Exception:
    numbers = {errno.ENOENT: 101, errno.EACCES: denied, errno.EPERM: denied}
    number = numbers.get(error.errno or 0, 121 if error.errno in _NO_PLAIN_FILE else 123)
    if error.errno in _NO_ROOM:
        number = 117
    elif error.errno == errno.EACCES and not os.path.lexists(path):
        number = 123  # the directory is closed to us
    elif error.errno == errno.ENOENT and (flags & os.O_CREAT or not path.parent.is_dir()):
        number = 123  # with O_CREAT only the directory can be missing
    what = _NO_PLAIN_FILE.get(error.errno or 0) if number == 121 else None
    return channel_error(number, what or error.strerror or str(error), path)


def read_header(fd: int) -> tuple[bytes, int]:
    """Return a private copy of the first 512 bytes (fewer if the file is shorter), and the file's size."""
    size = os.fstat(fd).st_size
    return os.pread(fd, HEADER_SIZE, 0), size


def same_file(path: Path, device: int, inode: int) -> bool:
    """Return whether a name refers, without links, to a certain file."""
    try:
        found = os.lstat(path)
    except OSError:
        return False
    return (found.st_dev, found.st_ino) == (device, inode)


def create_complete(
    path: Path, temporary_prefix: str, head: bytes, size: int, rights: Rights, *, replace: bool = True
) -> int:
    """Create a file of ``size`` bytes that begins with ``head``, visible only when it is complete (M1).

    Return its descriptor, open for reading and writing. Raises ChannelError SHM117 without room, SHM102 if
    owner or group cannot be set, SHM119 if another user's file has the name, SHM123 if the directory cannot
    be used; without ``replace``, FileExistsError if the name exists.
    """
    temporary, fd = _new_file(path.parent, temporary_prefix)
    try:
        try:
            os.posix_fallocate(fd, 0, size)
            os.pwrite(fd, head, 0)
        except OSError as error:
            what = f"cannot allocate {size} bytes: {error.strerror}"
            raise channel_error(117 if error.errno in _NO_ROOM else 123, what, path.parent) from error
        rights.give(fd, temporary)
        try:
            if replace:
                temporary.rename(path)
            else:
                os.link(temporary, path)
                temporary.unlink(missing_ok=True)
        except FileExistsError:
            raise
        except OSError as error:
            number = {IsADirectoryError: 121, PermissionError: 119}.get(type(error), 123)
            raise channel_error(number, (error.strerror or "") if number == 123 else "", path) from error
    except BaseException:
        os.close(fd)
        temporary.unlink(missing_ok=True)
        raise
    return fd


def _new_file(directory: Path, prefix: str) -> tuple[Path, int]:
    """Create a new file; with O_EXCL, a link that another user put at a guessed name is not followed."""
    for attempt in range(_ATTEMPTS):
        temporary = directory / f"{prefix}{secrets.token_hex(4)}"
        try:
            return temporary, open_plain_file(temporary, os.O_RDWR | os.O_CREAT | os.O_EXCL, denied=123)
        except ChannelError as error:
            if not isinstance(error.__cause__, FileExistsError) or attempt == _ATTEMPTS - 1:
                raise
    raise AssertionError  # the loop returns or raises


def user_name(uid: int) -> str:
    """Return a user's name, or the number if it has no name on this machine."""
    with suppress(KeyError):
        return pwd.getpwuid(uid).pw_name
    return str(uid)


def group_name(gid: int) -> str:
    """Return a group's name, or the number if it has no name on this machine."""
    with suppress(KeyError):
        return grp.getgrgid(gid).gr_name
    return str(gid)


def describe_status(found: os.stat_result) -> str:
    """Return owner, group and mode, such as ``root:root 0750``."""
    return f"{user_name(found.st_uid)}:{group_name(found.st_gid)} {stat.S_IMODE(found.st_mode):04o}"


def describe_owner(path: Path) -> str:
    """Return a file's owner, group and mode, such as ``root:root 0750``."""
    try:
        return describe_status(path.stat())
    except OSError:
        return "belongs to another user"


class NameLock:
    """An exclusive flock on a name's lock file, held until :meth:`release`.

    The kernel releases it whenever the process dies. The file itself stays: if it were removed, two bridges
    could hold "the" lock. Its size stores one bit: 1 while a bridge's object has the name, 0 before that and
    after the object was retired. Its modification time shows when a holder was last seen. The file gets the
    object's mode and group; an existing file may belong to ``rights.uid``, this process's user or root.

    Raises ChannelError SHM116 if another bridge holds it, SHM119 if the file belongs to another user, SHM102
    if its group cannot be set, SHM121 if it is not a plain file or has hard links, SHM123 if the directory
    cannot be used.
    """

    def __init__(self, path: Path, rights: Rights) -> None:
        self.path = path
        self.unheld_ns = 0  # for how long nothing had held the lock before, ns; 0 where that is not known
        self.fd = -1  # -1 once it is released
        while True:
            fd = _open_or_create(path)
            try:
                fcntl.flock(fd, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError as error:
                os.close(fd)
                raise channel_error(116, where=path) from error
            except BaseException:
                os.close(fd)
                raise
            self.fd = fd
            # If the file was removed between open and flock, this is a lock on nothing.
            if self.still_there():
                break
            self.release()
        try:
            self._refuse_foreign(rights.uid)
            self._share(rights.mode & 0o666, rights.gid)
            status = os.fstat(self.fd)
            if status.st_size:  # an object has been there, and so has a holder
                self.unheld_ns = max(0, time.time_ns() - status.st_mtime_ns)
        except OSError as error:
            self.release()
            what = f"cannot set the group and mode of the lock file: {error.strerror}"
            raise channel_error(102, what, path) from error
        except BaseException:
            self.release()
            raise

    @property
    def held_an_object(self) -> bool:
        """Whether a bridge has created an object with the name and not retired it."""
        return os.fstat(self.fd).st_size > 0

    def remember_object(self, there: bool) -> None:
        """Note that an object of this bridge has the name, or was retired."""
        # A size without content takes no page of a directory that may be full.
        os.ftruncate(self.fd, 1 if there else 0)

    def _refuse_foreign(self, uid: int | None) -> None:
        refuse_second_name(self.fd, self.path)
        owner = os.fstat(self.fd).st_uid
        # An owner may remove the file, and with it the lock, at any time.
        if owner not in (0, os.geteuid(), uid):
            raise channel_error(119, f"the lock file belongs to user {user_name(owner)}", self.path)

    def _share(self, mode: int, gid: int | None) -> None:
        status = os.fstat(self.fd)
        if status.st_uid == os.geteuid():
            if gid is not None and status.st_gid != gid:
                os.fchown(self.fd, -1, gid)
            os.fchmod(self.fd, mode)

    def still_there(self) -> bool:
        """Return whether the lock is held and the name still refers to the locked file."""
        if self.fd < 0:
            return False
        mine = os.fstat(self.fd)
        return same_file(self.path, mine.st_dev, mine.st_ino)

    def show(self) -> None:
        """Update the file's time stamp to show that the lock is held; call this every few seconds."""
        if self.fd >= 0:
            os.utime(self.fd)

    def release(self) -> None:
        """Release the lock; a second call does nothing."""
        if self.fd >= 0:
            os.close(self.fd)
            self.fd = -1

    def __del__(self) -> None:
        # A descriptor is a plain number: one that is not closed keeps the name until the process ends.
        self.release()


def _open_or_create(path: Path) -> int:
    # Never O_CREAT on what exists: with fs.protected_regular the kernel refuses that for another user's
    # file in a directory like /dev/shm, to root too, with no more than "permission denied".
    while True:
        for flags in (0, os.O_CREAT | os.O_EXCL):
            try:
                return open_plain_file(path, os.O_RDWR | flags, denied=119)
            except ChannelError as error:
                if error.code != "SHM101" and not isinstance(error.__cause__, FileExistsError):
                    raise
