"""What the kernel tells of processes, in ``/proc``: names, masks, and who has locked a file."""

from __future__ import annotations

import os
import re
from collections.abc import Mapping
from pathlib import Path

Held = Mapping[tuple[int, int, int], int]
"""File (major and minor number of its device, inode) → the process that holds an flock on it."""


def name_of(pid: int) -> str:
    """Return a process's name in parentheses, behind a blank; empty if it is not known."""
    try:
        name = Path(f"/proc/{pid}/comm").read_text(encoding="utf-8", errors="replace").strip()
    except OSError:
        return ""
    return f" ({name})"


def status_mask(status: Path, name: str) -> int:
    """Return a mask in a process's ``status``, such as ``CapEff`` (proc(5)); 0 if it has none."""
    found = re.search(rf"^{name}:\s*([0-9a-fA-F]+)", status.read_text("utf-8", "replace"), re.MULTILINE)
    return int(found[1], 16) if found else 0


def held_files(proc: Path = Path("/proc")) -> Held | None:
    """Return the files that processes hold an flock on; None if the kernel does not show them."""
    try:
        text = (proc / "locks").read_text(encoding="utf-8", errors="replace")
    except OSError:
        return None
    found = {}
    for line in text.splitlines():
        words = line.split()
        if len(words) >= 6 and words[1] == "FLOCK":
            major, minor, inode = words[5].split(":")
            found[int(major, 16), int(minor, 16), int(inode)] = int(words[4])
    return found


def file_key(path: Path) -> tuple[int, int, int]:
    """Return what :data:`Held` knows a file by. Raises OSError."""
    status = path.lstat()
    return os.major(status.st_dev), os.minor(status.st_dev), status.st_ino


def holder(path: Path, held: Held | None) -> int:
    """Return the process that holds an flock on a file; 0 if none does, or it is not known."""
    try:
        return max(0, (held or {}).get(file_key(path), 0))
    except OSError:
        return 0
