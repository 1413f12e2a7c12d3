"""A folder of this process's own, for targets that read files."""

from __future__ import annotations

import atexit
import shutil
import tempfile
from functools import cache
from pathlib import Path

__all__ = ["emptied", "scratch"]


@cache
def scratch() -> Path:
    """Return the folder; a campaign gives each fuzzer a ``TMPDIR`` that it removes itself."""
    folder = Path(tempfile.mkdtemp(prefix="fuzz-"))
    atexit.register(shutil.rmtree, folder, ignore_errors=True)
    return folder


def emptied(name: str) -> Path:
    """Return a folder below it that is there and empty."""
    folder = scratch() / name
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    return folder
