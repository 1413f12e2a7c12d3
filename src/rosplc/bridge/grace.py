"""The first moment of a topic towards ROS: what comes before anybody is there waits, briefly.

A PLC writes while the bridge is down; the bridge starts and finds the message at once, but its
subscribers need some hundred milliseconds to find the bridge. A volatile subscriber would miss
what was sent before that.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterator
from typing import Generic, TypeVar

__all__ = ["GRACE_NS", "Grace"]

_T = TypeVar("_T")

GRACE_NS = 1_000_000_000
"""How long after the start messages may wait for the first subscriber."""

_LOOK_NS = 5_000_000


class Grace(Generic[_T]):
    """Keeps items until somebody is there, the time is over, or no more may wait; never opens again.

    Args:
        until_ns: When the time is over.
        most: How many items may wait; with 1 the newest alone.
        is_there: Whether somebody is there; asked only while something waits.

    Attributes:
        due_ns: When to ask again (:meth:`release`); None if nothing waits.
        over: Whether everything may go from now on.
        replaced: Items that never went because a newer one took their place.
    """

    def __init__(self, until_ns: int, most: int, is_there: Callable[[], bool]) -> None:
        self.due_ns: int | None = None
        self.replaced = 0
        self._until_ns = until_ns
        self._most = most
        self._is_there = is_there
        self._held: deque[_T] = deque()
        self.over = False

    def offer(self, item: _T, now_ns: int) -> bool:
        """Keep an item; False if it may go, after what :meth:`release` yields."""
        if self._ends(now_ns):
            return False
        if len(self._held) == self._most:
            if self._most > 1:
                self.over = True
                return False
            self._held.clear()
            self.replaced += 1
        self._held.append(item)
        self.due_ns = min(now_ns + _LOOK_NS, self._until_ns)
        return True

    def release(self, now_ns: int, *, anyway: bool = False) -> Iterator[_T]:
        """Yield what waited, if it may go now or should go anyway."""
        if anyway or self._ends(now_ns):
            self.over = True
            self.due_ns = None
            while self._held:
                yield self._held.popleft()
        elif self._held:
            self.due_ns = min(now_ns + _LOOK_NS, self._until_ns)

    def _ends(self, now_ns: int) -> bool:
        self.over = self.over or now_ns >= self._until_ns or self._is_there()
        return self.over
