"""What the operating system says of a process whose number stands in an object.

The number is for people: it may be of another container, or have gone to another program since.
"""

from __future__ import annotations

from pathlib import Path

__all__ = ["process_words"]

_STOPPED = ("T", "t")


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
    return "that process is stopped (SIGSTOP)" if state in _STOPPED else "that process is there, but hangs"
