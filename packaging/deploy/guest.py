"""How much memory a 32-bit program takes, seen from outside the emulator that runs it.

The emulator lays the program's whole address space, 4 GiB, at one place of its own. What is resident
there is what would be on the board: its heap, its stacks, the pages of its code that were read. The
emulator's own memory, above all the code that it translated, lies elsewhere and is not counted.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

__all__ = ["ENVIRONMENT", "GuestMemory", "guest_memory"]

_BASE = 0x2_0000_0000
_SIZE = 1 << 32
ENVIRONMENT = {"QEMU_GUEST_BASE": hex(_BASE)}
"""Makes the emulator use the place that :func:`guest_memory` looks at."""


@dataclass(frozen=True)
class GuestMemory:
    """Resident memory in KiB.

    Attributes:
        own: Pages that only this process has: heap, stacks, changed data.
        files: Pages of programs and libraries, which processes with the same ones share.
        shared: Pages of shared memory, such as channels.
    """

    own: int
    files: int
    shared: int

    @property
    def total(self) -> int:
        """All of it."""
        return self.own + self.files + self.shared


def guest_memory(pid: int) -> GuestMemory:
    """Return what the program in an emulator holds.

    Args:
        pid: The emulator's process, started with :data:`ENVIRONMENT`.

    Raises:
        OSError: The process has ended.
    """
    own = files = shared = 0
    inside, name = False, ""
    for line in Path(f"/proc/{pid}/smaps").read_text(encoding="utf-8", errors="replace").splitlines():
        words = line.split()
        if not words[0].endswith(":"):
            start = int(words[0].partition("-")[0], 16)
            inside = _BASE <= start < _BASE + _SIZE
            name = words[5] if len(words) > 5 else ""
        elif inside and words[0] == "Rss:":
            rss = int(words[1])
        elif inside and words[0] == "Anonymous:":
            anonymous = int(words[1])
            own += anonymous
            if name.startswith("/dev/shm"):
                shared += rss - anonymous
            else:
                files += rss - anonymous
    return GuestMemory(own, files, shared)
