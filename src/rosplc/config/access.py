"""Who gets at the objects: users and groups as numbers, and what is left open to everybody."""

from __future__ import annotations

import grp
import pwd
import stat
from collections.abc import Callable
from pathlib import Path

from rosplc.config.file import Config
from rosplc.config.problems import Absent
from rosplc.errors import ConfigError
from rosplc.shm.files import Rights

__all__ = ["group_id", "open_doors", "rights", "user_id"]

_LARGEST_ID = 2**32 - 2


def open_doors(config: Config) -> list[str]:
    """Return a sentence for each way in which every user of the machine may read or write the objects."""
    shm = config.settings.shm
    found = []
    if shm.mode & 0o006:
        verbs = {0o2: "write", 0o4: "read", 0o6: "read and write"}[shm.mode & 0o006]
        found.append(
            f"shm.mode {shm.mode:04o} lets every user of this machine {verbs} the objects; "
            'use "0660" and a group in shm.group'
        )
    try:
        mode = Path(shm.directory).stat().st_mode
    except OSError:
        return found  # opening it says so
    if mode & stat.S_IWOTH and not mode & stat.S_ISVTX:
        found.append(
            f"{shm.directory} is {stat.S_IMODE(mode):04o}: every user of this machine may remove and replace "
            f"the objects there; `chmod +t {shm.directory}` keeps users apart"
        )
    return found


def rights(config: Config) -> Rights:
    """Return mode, owner and group of the objects. Raises CFG004 for an unknown user or group."""
    return Rights(config.settings.shm.mode, user_id(config), group_id(config))


def user_id(config: Config) -> int | None:
    """Return ``shm.owner`` as a number. Raises CFG004 at its line if there is no such user."""
    return _id(config, "owner", "user", lambda name: pwd.getpwnam(name).pw_uid)


def group_id(config: Config) -> int | None:
    """Return ``shm.group`` as a number. Raises CFG004 at its line if there is no such group."""
    return _id(config, "group", "group", lambda name: grp.getgrnam(name).gr_gid)


def _id(config: Config, key: str, kind: str, find: Callable[[str], int]) -> int | None:
    given: str | int | None = getattr(config.settings.shm, key)
    place = config.source.place(("shm", key))
    if isinstance(given, str):
        try:
            return find(given)
        except KeyError:
            what = f"there is no {kind} {given!r} on this machine"
            remedy = "Create it, or name another; `getent passwd` and `getent group` list them."
            raise Absent("CFG004", what, where=place, remedy=remedy) from None
    # -1 and its unsigned twin would mean "leave it as it is" to the kernel.
    if given is not None and not 0 <= given <= _LARGEST_ID:
        raise ConfigError("CFG004", f"{given} is not within 0 … {_LARGEST_ID}", where=place)
    return given
