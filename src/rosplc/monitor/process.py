"""What the operating system says of a process whose number stands in an object.

The number is for people: it may be of another container, or have gone to another program since.
"""

from __future__ import annotations

import os
import time
from pathlib import Path

__all__ = ["is_starting", "process_words"]

_STOPPED = ("T", "t")
_THERE = "that process is there, but hangs"
_YOUNG_S = 30.0
"""A bridge claims its objects, joins ROS, and only then beats."""
_START_TIME = 19
"""Where the start stands among the fields behind the name, in ticks since the machine's start."""


def is_starting(pid: int, proc: Path = Path("/proc"), *, now_s: float | None = None) -> bool:
    """Return whether a bridge that was not seen to beat is so young that it may not have begun to.

    Args:
        pid: Its number, as the bridge wrote it; 0 for none.
        proc: Where the kernel tells; another place is for tests.
        now_s: Seconds since the machine's start; None asks the clock.
    """
    if not pid or process_words(pid, proc) != _THERE:
        return False
    now_s = time.clock_gettime(time.CLOCK_BOOTTIME) if now_s is None else now_s
    try:
        fields = (proc / str(pid) / "stat").read_text(encoding="utf-8", errors="replace").rpartition(")")[2]
        began_s = int(fields.split()[_START_TIME]) / os.sysconf("SC_CLK_TCK")
    except (OSError, IndexError, ValueError):
        return False
    return now_s - began_s < _YOUNG_S


def process_words(pid: int, proc: Path = Path("/proc")) -> str:
    """Return how a process stands that should be a bridge's and does not beat; empty if that is not known.

    Args:
        pid: Its number, as the bridge wrote it.
        proc: Where the kernel tells; another place is for tests.
    """
    folder = proc / str(pid)
    try:
        # The name in parentheses may hold anything, parentheses too.
        state = (folder / "stat").read_text(encoding="utf-8", errors="replace").rpartition(")")[2].split()[0]
        command = (folder / "cmdline").read_bytes()
    except (FileNotFoundError, ProcessLookupError):
        return "there is no such process here"
    except (OSError, IndexError):
        return ""
    if state == "Z":
        return "that process has ended"
    if b"rosplc" not in command and b"python" not in command:
        return "that number is another program's"
    return "that process is stopped (SIGSTOP)" if state in _STOPPED else _THERE
