"""The other side of a block's channel: alive, or silent for too long, by the block's own clock."""

from __future__ import annotations

from rosplc.shm import Liveness
from rosplc.shm.liveness import silence_ns

__all__ = ["Peer"]


class Peer:
    """Watches one beat.

    Attributes:
        alive: The beat or the sequence changed within the time that the peer promises.
        silent: Neither did for longer than that. Just after the attach a peer is neither.
    """

    def __init__(self) -> None:
        self.alive = False
        self.silent = False
        self._beat_ms = -1
        self._liveness = Liveness(0)
        self._since_ns = 0

    def observe(self, beat: int, sequence: int, beat_ms: int, now_ns: int) -> None:
        """Take in the words as they stand at ``now_ns``, a monotonic time."""
        if beat_ms != self._beat_ms:
            # Another writer, or the first one after its claim: its own promise counts.
            self._beat_ms, self._liveness = beat_ms, Liveness(beat_ms)
        self.alive = self._liveness.observe(beat, sequence, now_ns)
        if self.alive or self._since_ns == 0:
            self._since_ns = now_ns
        self.silent = now_ns - self._since_ns > silence_ns(beat_ms)
