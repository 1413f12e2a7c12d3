"""The last minutes in memory, as finished chunks, until something happens."""

from __future__ import annotations

import threading
from collections import deque

from rosplc.clock import SYSTEM, Clock
from rosplc.recorder.mcap_write import SealedChunk

__all__ = ["Ring"]

_CHUNK_OVERHEAD = 1024
_CHANNEL_OVERHEAD = 300  # its places in two dictionaries
"""What a chunk costs beyond its bytes, rounded up."""


class Ring:
    """Keeps chunks for a time and within a size; the oldest give way. From any thread.

    Args:
        keep_ns: How long a chunk is kept.
        most_bytes: Bytes that all of them may have.
        clock: What their age is judged by.
    """

    def __init__(self, keep_ns: int, most_bytes: int, clock: Clock = SYSTEM) -> None:
        self._clock = clock
        self._keep_ns, self._most_bytes = keep_ns, most_bytes
        self._chunks: deque[tuple[int, int, SealedChunk]] = deque()
        self._lock = threading.Lock()
        self.size = 0
        self.cut_short = False
        """Whether the size made a chunk give way before its time."""

    def take(self, chunk: SealedChunk) -> None:
        """Add a chunk."""
        now = self._clock.monotonic_ns()
        cost = len(chunk.blob) + _CHUNK_OVERHEAD + _CHANNEL_OVERHEAD * len(chunk.counts)
        with self._lock:
            self._chunks.append((now, cost, chunk))
            self.size += cost
            while self._chunks and now - self._chunks[0][0] > self._keep_ns:
                self.size -= self._chunks.popleft()[1]
            while self.size > self._most_bytes and len(self._chunks) > 1:
                self.size -= self._chunks.popleft()[1]
                self.cut_short = True

    def chunks(self) -> list[SealedChunk]:
        """Return what is kept, the oldest first."""
        with self._lock:
            return [chunk for _, _, chunk in self._chunks]

    @property
    def span_ns(self) -> int:
        """From the oldest message kept to the newest."""
        with self._lock:
            if not self._chunks:
                return 0
            return max(0, self._chunks[-1][2].end_ns - self._chunks[0][2].start_ns)
