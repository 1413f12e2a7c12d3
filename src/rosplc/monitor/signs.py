"""Rates and signs of life, as a look now and then can see them."""

from __future__ import annotations

from collections import deque

from rosplc.shm import Liveness

__all__ = ["Peers", "Rate"]

_LEAST_MS = 334
"""Beats are taken for at least so long: views look seldom, and must not flicker on a busy machine."""


class _Peer:
    def __init__(self, beat_ms: int, now_ns: int) -> None:
        self.beat_ms = beat_ms
        period = max(beat_ms, _LEAST_MS) if beat_ms else 0
        self._liveness = Liveness(period)
        self.seen = False
        self._until_ns = now_ns + 3 * min(max(period, _LEAST_MS), 10_000) * 1_000_000

    def look(self, beat: int, count: int, now_ns: int) -> bool | None:
        if self._liveness.observe(beat, count, now_ns):
            self.seen = True
            return True
        return None if now_ns < self._until_ns else False


class Peers:
    """Judges every claim of one object."""

    def __init__(self) -> None:
        self._known: dict[int, tuple[int, _Peer]] = {}

    def alive(self, key: int, claim: int, beat_ms: int, beat: int, count: int, now_ns: int) -> bool | None:
        """Return whether a claimant lives; None before that can be known.

        Args:
            key: Which line.
            claim: The claim; 0 is nobody, and nobody is not alive.
            beat_ms: The period that is promised.
            beat: The beat.
            count: What moves as well: head or taken.
            now_ns: The time of a monotonic clock.
        """
        if not claim:
            self._known.pop(key, None)
            return False
        known = self._known.get(key)
        if known is None or known[0] != claim or known[1].beat_ms != beat_ms:
            known = self._known[key] = (claim, _Peer(beat_ms, now_ns))
        return known[1].look(beat, count, now_ns)

    def seen(self, key: int) -> bool:
        """Return whether the claimant of a line was seen alive, at some time since it claimed."""
        known = self._known.get(key)
        return known is not None and known[1].seen


_WINDOW_NS = 2_000_000_000
_LONGEST_NS = 30_000_000_000
_FEWEST = 4
_MISSED = 2


class Rate:
    """Messages per second, from looks at the number of messages.

    It counts over the last two seconds, and over up to half a minute where fewer than three messages came
    in them, so that one message a second reads as 1 and not as 0 and 2 in turn.
    """

    def __init__(self) -> None:
        self._changes: deque[tuple[int, int]] = deque()

    def of(self, count: int, now_ns: int) -> float | None:
        """Note the number at ``now_ns`` of a monotonic clock; return the rate in Hz, None before it is known.

        Args:
            count: Messages so far; it never falls.
            now_ns: The time.
        """
        changes = self._changes
        if not changes or changes[-1][1] != count:
            changes.append((now_ns, count))
        while len(changes) > _FEWEST and now_ns - changes[1][0] > _WINDOW_NS:
            changes.popleft()
        while len(changes) > 1 and now_ns - changes[1][0] > _LONGEST_NS:
            changes.popleft()
        (then, before), (last, after) = changes[0], changes[-1]
        if after == before:
            # One look tells nothing; the first change after a long time says when, and not how often.
            return 0.0 if now_ns - then > _WINDOW_NS else None
        mean = (last - then) / (after - before)
        late = now_ns - last > max(_MISSED * mean, _WINDOW_NS / 4)
        if now_ns - last > max(_WINDOW_NS, 5 * mean):
            return 0.0
        span = (now_ns if late else last) - then
        return (after - before) * 1e9 / span if span > 0 else None
