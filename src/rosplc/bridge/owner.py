"""Users and groups of the configuration as numbers of this machine."""

from __future__ import annotations

import grp
import pwd

from rosplc.config.file import Config
from rosplc.errors import ConfigError

__all__ = ["group_id", "user_id"]

_LARGEST_ID = 2**32 - 2


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
    return ConfigError("CFG004", what, where=config.source.place(("shm", key)), remedy=remedy)
