"""Checks that a path can be read as a recording: reading from a pipe could block forever."""

from __future__ import annotations

import stat
from pathlib import Path

CHECK_PATH = "Check the path."
GIVE_FILE = "Specify the file or folder of a recording; save piped data to a file first."
_OPENED = (".bag", ".db3", ".mcap", ".yaml", ".zstd")


def unreadable_kind(path: Path, *, folder: bool = True) -> tuple[str, str]:
    """Return why a path cannot be a recording, and what to do; two empty texts if it may be one.

    The files in a folder are checked as well.
    """
    try:
        mode = path.stat().st_mode
        if stat.S_ISDIR(mode):
            if not folder:
                return "this is a folder", "Specify one of its files."
            for one in sorted(path.iterdir()):
                if one.suffix in _OPENED and one.exists() and not (one.is_file() or one.is_dir()):
                    return f"{one.name} in this folder is not a regular file", GIVE_FILE
            return "", ""
    except FileNotFoundError:
        return "there is no such file", CHECK_PATH
    except (OSError, ValueError) as error:  # a name with a NUL is a ValueError
        return getattr(error, "strerror", None) or str(error), "Check the path and its permissions."
    return ("", "") if stat.S_ISREG(mode) else ("this is not a regular file", GIVE_FILE)
