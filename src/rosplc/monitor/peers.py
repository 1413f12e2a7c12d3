"""Signs of life of those who hold a claim, as a look now and then can see them."""

from __future__ import annotations

from rosplc.shm import Liveness

__all__ = ["Peers"]

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
