"""Whether a peer lives, by the observer's own clock (spec/shm-format.md, M6 and M21)."""

from __future__ import annotations

from rosplc.shm.constants import MAX_BEAT_MS

__all__ = ["Liveness", "silence_ns"]


def silence_ns(beat_ms: int, factor: int = 3) -> int:
    """Return how long, in ns, a beat may stand still before its claim counts as abandoned (M6, M9)."""
    if beat_ms == 0:
        return 1_000_000_000
    return max(100, factor * min(beat_ms, MAX_BEAT_MS)) * 1_000_000


class Liveness:
    """Judge one peer from its beat and head, both 32-bit words.

    A peer is alive from the first change that is seen until nothing has changed for ``factor``
    periods. What stands still since the first look has shown no life.

    Args:
        period_ms: The period that the peer promises; 0 counts as a third of a second, more than
            10 s as 10 s (a damaged word must not keep a dead peer alive for months).
        factor: How many periods it may miss.
    """

    def __init__(self, period_ms: int, factor: int = 3) -> None:
        self._limit_ns = factor * min(period_ms, MAX_BEAT_MS) * 1_000_000 if period_ms else 1_000_000_000
        self._seen: tuple[int, int] | None = None
        self._changed_ns: int | None = None

    def observe(self, beat: int, head: int, now_ns: int) -> bool:
        """Note the words at ``now_ns`` of a monotonic clock, and return whether the peer lives."""
        if self._seen != (beat, head):
            if self._seen is not None:
                self._changed_ns = now_ns
            self._seen = (beat, head)
        return self._changed_ns is not None and now_ns - self._changed_ns < self._limit_ns
