"""Rate limit: in between two messages the newest waits, and the last one is never dropped."""

from __future__ import annotations

from typing import Generic, TypeVar

__all__ = ["Gate"]

_T = TypeVar("_T")


class Gate(Generic[_T]):
    """Lets one item through per interval; the clock is passed in, and the caller locks.

    Args:
        interval_ns: Shortest time between two items; 0 lets everything through.

    Attributes:
        due_ns: When the item that waits may go; None if none waits.
        replaced: Items that never went because a newer one took their place.
    """

    def __init__(self, interval_ns: int) -> None:
        self.interval_ns = interval_ns
        self.due_ns: int | None = None
        self.replaced = 0
        self._open_ns: int | None = None
        self._waiting: _T | None = None

    def offer(self, item: _T, now_ns: int) -> _T | None:
        """Return the item if it may go now, else keep it and return None."""
        if self._open_ns is None or now_ns >= self._open_ns:
            if self.due_ns is not None:
                self.replaced += 1
                self.due_ns = self._waiting = None
            self._open_ns = now_ns + self.interval_ns
            return item
        if self.due_ns is not None:
            self.replaced += 1
        self._waiting = item
        self.due_ns = self._open_ns
        return None

    def flush(self, now_ns: int) -> _T | None:
        """Return the item that waits, if its time has come."""
        if self.due_ns is None or now_ns < self.due_ns:
            return None
        item, self._waiting, self.due_ns = self._waiting, None, None
        self._open_ns = now_ns + self.interval_ns
        return item
