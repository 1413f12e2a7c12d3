"""What Read and Write blocks share: they belong to one task and notice being re-entered."""

from __future__ import annotations

import threading

from rosplc.virtual_plc.scan import Scan

__all__ = ["IN_USE", "SILENT", "UNKNOWN", "Owner"]

IN_USE = 124
"""Error number of a block that a second task called (spec/shm-format.md, section 9)."""

SILENT = 125
"""Error number while the other side does not beat."""

UNKNOWN = 0xFFFFFFFF
"""A number of sources or sinks that nobody knows."""


class Owner:
    """Keeps a block's instance to the task that called it first.

    Attributes:
        refused: Calls that were turned away, because another task owns the instance or
            because it was being called at that moment.
    """

    def __init__(self) -> None:
        self.refused = 0
        self._task: str | None = None
        self._busy = threading.Lock()

    def enter(self, scan: Scan) -> bool:
        """Return whether the call may go on; :meth:`leave` must follow if it may."""
        if not self._busy.acquire(blocking=False):
            self.refused += 1
            return False
        if scan.task:
            if self._task is None:
                self._task = scan.task
            elif self._task != scan.task:
                self.refused += 1
                self._busy.release()
                return False
        return True

    def leave(self) -> None:
        """End the call."""
        self._busy.release()
