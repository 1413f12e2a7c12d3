"""A run's folder in /dev/shm: gone at its end, and at the next run's start if that end was a kill."""

from __future__ import annotations

import contextlib
import fcntl
import os
import re
import shutil
import stat
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from rosplc.errors import SetupError

__all__ = ["MEMORY", "NAMES_FILE", "PREFIX", "scratch_folder", "sweep"]

MEMORY = Path("/dev/shm")
PREFIX = "rosplc-bench-"
NAMES_FILE = "names"
"""A file in a contender's folder: how those files begin that it has to put directly into /dev/shm."""

_LOCK = "lock"
_NAME = r"\Arb[0-9a-f]{8}_\Z"
_YOUNG_SECONDS = 60.0


@contextmanager
def scratch_folder(memory: Path = MEMORY) -> Iterator[Path]:
    """Give a folder for what this run shares, and remove it at the end; remove those of dead runs first.

    Raises:
        SetupError: SYS008, shared memory cannot be used.
    """
    sweep(memory)
    try:
        folder = Path(tempfile.mkdtemp(prefix=PREFIX, dir=memory))
    except OSError as error:
        raise SetupError("SYS008", f"{error.strerror}", where=str(memory)) from error
    try:
        # Held as long as this process lives, however it ends; no child inherits it.
        with (folder / _LOCK).open("w") as lock:
            fcntl.flock(lock, fcntl.LOCK_EX)
            yield folder
    finally:
        _remove(folder)


def sweep(memory: Path = MEMORY) -> list[Path]:
    """Remove what runs have left that were killed; return their folders."""
    removed = []
    for folder in memory.glob(f"{PREFIX}*"):
        with contextlib.suppress(OSError):
            status = folder.lstat()
            if stat.S_ISDIR(status.st_mode) and status.st_uid == os.geteuid() and not _alive(folder):
                _remove(folder)
                removed.append(folder)
    return removed


def _alive(folder: Path) -> bool:
    try:
        descriptor = os.open(folder / _LOCK, os.O_RDWR | os.O_NOFOLLOW | os.O_CLOEXEC)
    except FileNotFoundError:
        # Between making a folder and locking it lies a moment.
        return time.time() - folder.stat().st_mtime < _YOUNG_SECONDS
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return True
    finally:
        os.close(descriptor)
    return False


def _remove(folder: Path) -> None:
    beside = [f"sem.{folder.name}."]  # semaphores know no folders; neither do some contenders' files
    for file in folder.glob(f"*/{NAMES_FILE}"):
        with contextlib.suppress(OSError):
            beside += re.findall(_NAME, file.read_text())
    for prefix in beside:
        for path in folder.parent.iterdir():
            if path.name.startswith(prefix):
                with contextlib.suppress(OSError):
                    path.unlink()
    shutil.rmtree(folder, ignore_errors=True)
