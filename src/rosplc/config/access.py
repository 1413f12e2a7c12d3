"""Who gets at the objects: users and groups as numbers, and what is left open to everybody."""

from __future__ import annotations

import grp
import pwd
import stat
from pathlib import Path

from rosplc.config.file import Config
from rosplc.config.problems import Absent
from rosplc.errors import ConfigError

__all__ = ["group_id", "open_doors", "user_id"]

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


def user_id(config: Config) -> int | None:
    """Return ``shm.owner`` as a number. Raises CFG004 at its line if there is no such user."""
    owner = config.settings.shm.owner
    if not isinstance(owner, str):
        return _checked(config, "owner", owner)
    try:
        return pwd.getpwnam(owner).pw_uid
    except KeyError:
        raise _unknown(config, "owner", f"there is no user {owner!r} on this machine") from None


def group_id(config: Config) -> int | None:
    """Return ``shm.group`` as a number. Raises CFG004 at its line if there is no such group."""
    group = config.settings.shm.group
    if not isinstance(group, str):
        return _checked(config, "group", group)
    try:
        return grp.getgrnam(group).gr_gid
    except KeyError:
        raise _unknown(config, "group", f"there is no group {group!r} on this machine") from None


def _checked(config: Config, key: str, number: int | None) -> int | None:
    # -1 and its unsigned twin would mean "leave it as it is" to the kernel.
    if number is not None and not 0 <= number <= _LARGEST_ID:
        raise ConfigError(
            "CFG004", f"{number} is not within 0 … {_LARGEST_ID}", where=config.source.place(("shm", key))
        )
    return number


def _unknown(config: Config, key: str, what: str) -> ConfigError:
    remedy = "Create it, or name another; `getent passwd` and `getent group` list them."
    return Absent("CFG004", what, where=config.source.place(("shm", key)), remedy=remedy)
