"""Chunks between the reader and the disk: compressed by a thread of their own, or kept in memory."""

from __future__ import annotations

import queue
import threading
from collections import deque
from collections.abc import Callable

from rosplc.clock import SYSTEM, Clock
from rosplc.recorder.mcap_write import Batch, Compression, SealedChunk, seal

__all__ = ["Outlet", "Ring"]


class Outlet:
    """Compresses batches and passes them on, in order; bounded.

    Args:
        take: Given each chunk, by this outlet's thread.
        compression: How chunks are compressed.
        most_bytes: Uncompressed bytes that may wait; what comes beyond is dropped and counted.

    Attributes:
        dropped: Channel id → messages that were dropped, because the disk does not keep up or failed.
        error: What ended it before its time; None if nothing has.
    """

    def __init__(
        self, take: Callable[[SealedChunk], None], compression: Compression, most_bytes: int = 64 << 20
    ) -> None:
        self._take, self._compression, self._most_bytes = take, compression, most_bytes
        self.dropped: dict[int, int] = {}
        self.error: Exception | None = None
        self._waiting = 0
        self._lock = threading.Lock()
        self._queue: queue.SimpleQueue[Batch | None] = queue.SimpleQueue()
        self._thread = threading.Thread(target=self._run, name="rosplc-chunks", daemon=True)

    def start(self) -> None:
        """Begin."""
        self._thread.start()

    def put(self, batch: Batch) -> None:
        """Add a batch; never blocks."""
        size = len(batch.data)
        with self._lock:
            fits = self.error is None and self._waiting + size <= self._most_bytes
            if fits:
                self._waiting += size
        if fits:
            self._queue.put(batch)
        else:
            self._drop(batch)

    def stop(self) -> None:
        """Pass on what waits, and end."""
        self._queue.put(None)
        if self._thread.is_alive():
            self._thread.join()

    def _run(self) -> None:
        while (batch := self._queue.get()) is not None:
            with self._lock:
                self._waiting -= len(batch.data)
            if self.error is not None:
                self._drop(batch)
                continue
            try:
                self._take(seal(batch, self._compression))
            except Exception as error:  # whoever waits for the recording is told
                self._drop(batch)
                with self._lock:
                    self.error = error

    def _drop(self, batch: Batch) -> None:
        with self._lock:
            for channel, count in batch.counts().items():
                self.dropped[channel] = self.dropped.get(channel, 0) + count


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
