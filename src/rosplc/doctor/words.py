"""Small words that several examinations need."""

from __future__ import annotations

import grp
import pwd
import shlex
from collections.abc import Iterable
from pathlib import Path

__all__ = ["group_name", "listed", "remove", "user_name"]

_MOST = 4


def listed(items: Iterable[object], most: int = _MOST) -> str:
    """Return the first few of many things, and how many more there are."""
    texts = [str(item) for item in items]
    if len(texts) <= most:
        return ", ".join(texts)
    return f"{', '.join(texts[:most])} and {len(texts) - most} more"


def remove(paths: Iterable[Path], *, root: bool = False) -> str:
    """Return the command that removes files."""
    return f"{'sudo ' if root else ''}rm {' '.join(shlex.quote(str(path)) for path in paths)}"


def user_name(uid: int) -> str:
    """Return a user's name; its number where it has none here."""
    try:
        return pwd.getpwuid(uid).pw_name
    except KeyError:
        return f"user {uid}"


def group_name(gid: int) -> str:
    """Return a group's name; its number where it has none here."""
    try:
        return grp.getgrgid(gid).gr_name
    except KeyError:
        return f"group {gid}"
