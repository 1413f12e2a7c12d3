"""Who else may get at the objects: what a configuration leaves open to everybody on the machine."""

from __future__ import annotations

import stat
from pathlib import Path

from rosplc.config.file import Config

__all__ = ["open_doors"]


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
