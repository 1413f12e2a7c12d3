"""From batches to wherever chunks go, in a thread of its own: a slow disk must not keep the reader."""

from __future__ import annotations

import queue
import threading
from collections.abc import Callable

from rosplc.recorder.batch import Batch
from rosplc.recorder.mcap_write import Compression, SealedChunk, seal

__all__ = ["Outlet"]


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
