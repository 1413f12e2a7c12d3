"""The scan that the current thread is in: what its blocks share.

A PLC allows at most one attempt to open an object per scan over all blocks
(``spec/shm-format.md``, section 8.6), and a block may be called once in a scan by one
task only. Both need to know which scan a call belongs to; outside a task (a notebook, a
test) every call counts as a scan of its own.
"""

from __future__ import annotations

import threading
import time
from dataclasses import dataclass

__all__ = ["Scan", "current_scan", "enter_scan", "leave_scan"]


@dataclass(slots=True)
class Scan:
    """One scan of one task.

    Attributes:
        task: The task's name, empty outside a task.
        number: Counts the task's scans from 1; 0 outside a task.
        now_ns: The monotonic clock at the scan's start, nanoseconds.
        may_open: Whether this scan still has its one attempt to open an object.
    """

    task: str
    number: int
    now_ns: int
    may_open: bool = True

    def claim_open(self) -> bool:
        """Take the scan's one attempt to open an object; False if it is gone."""
        if not self.may_open:
            return False
        self.may_open = False
        return True


_local = threading.local()


def current_scan() -> Scan:
    """Return the scan that the calling thread is in, or a fresh one outside a task."""
    scan: Scan | None = getattr(_local, "scan", None)
    return Scan("", 0, time.monotonic_ns()) if scan is None else scan


def enter_scan(scan: Scan) -> None:
    """Make ``scan`` the calling thread's scan."""
    _local.scan = scan


def leave_scan() -> None:
    """End the calling thread's scan."""
    _local.scan = None
