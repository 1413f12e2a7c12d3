"""The objects of topics among the files of a directory."""

from __future__ import annotations

import os
import re
from pathlib import Path

from rosplc.shm import Attached
from rosplc.shm.files import open_plain_file

__all__ = ["object_prefix", "open_object"]

_OBJECT = re.compile(r"([A-Za-z][A-Za-z0-9_-]{0,31})\.t\..+", re.DOTALL)


def object_prefix(name: str) -> str | None:
    """Return the prefix in the name of a topic's object; None if the name is of something else."""
    found = _OBJECT.fullmatch(name)
    return None if found is None else found[1]


def open_object(path: str) -> Attached:
    """Map an object read-only, by its file: a shortened name does not give its topic away.

    Raises:
        ChannelError: As :func:`rosplc.shm.attach`.
    """
    fd = open_plain_file(Path(path), os.O_RDONLY)
    try:
        return Attached(fd, path, None, None, None, False)
    finally:
        os.close(fd)
