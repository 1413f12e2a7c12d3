"""Users, groups and modes of files, as a person reads them."""

from __future__ import annotations

import grp
import os
import pwd
import stat
from contextlib import suppress
from pathlib import Path

__all__ = ["describe_owner", "describe_status", "group_name", "user_name"]


def user_name(uid: int) -> str:
    """Return a user's name, or the number where this machine knows none."""
    with suppress(KeyError):
        return pwd.getpwuid(uid).pw_name
    return str(uid)


def group_name(gid: int) -> str:
    """Return a group's name, or the number where this machine knows none."""
    with suppress(KeyError):
        return grp.getgrgid(gid).gr_name
    return str(gid)


def describe_status(found: os.stat_result) -> str:
    """Return owner, group and mode, ``root:root 0750``."""
    return f"{user_name(found.st_uid)}:{group_name(found.st_gid)} {stat.S_IMODE(found.st_mode):04o}"


def describe_owner(path: Path) -> str:
    """Return a file's owner, group and mode, ``root:root 0750``."""
    try:
        return describe_status(path.stat())
    except OSError:
        return "somebody else"
