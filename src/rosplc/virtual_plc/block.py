"""What Read and Write blocks share: their task, their link, the other side, and their error."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from contextlib import contextmanager

from rosplc.layout import Layout
from rosplc.shm import Direction, Liveness, Namespace
from rosplc.shm.constants import ErrorNumber
from rosplc.shm.liveness import silence_ns
from rosplc.virtual_plc.link import Link
from rosplc.virtual_plc.scan import Scan, current_scan

__all__ = ["Block", "Peer"]


class Peer:
    """The other side of a channel, by the block's own clock.

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
        """Take in the words as they are at ``now_ns``, a monotonic time."""
        if beat_ms != self._beat_ms:
            # Another writer, or the first one after its claim: its own promise counts.
            self._beat_ms, self._liveness = beat_ms, Liveness(beat_ms)
        self.alive = self._liveness.observe(beat, sequence, now_ns)
        if self.alive or self._since_ns == 0:
            self._since_ns = now_ns
        self.silent = now_ns - self._since_ns > silence_ns(beat_ms)


class Block:
    """A block on one topic, which belongs to the task that calls it first.

    Attributes:
        udiReentries: Calls that were turned away, because another task owns the instance or was inside.
    """

    def __init__(
        self, topic: str, namespace: Namespace, direction: Direction, layout: Layout | None, beat_ms: int
    ) -> None:
        self.topic = topic
        self.xAttached = self.xPeerAlive = False
        self.udiError = self.udiSequence = self.udiReentries = 0
        self.reason = ""
        self._link = Link(
            topic, namespace=namespace, direction=direction, layout=layout,
            write=direction == Direction.TO_ROS,
        )  # fmt: skip
        self._beat_ms = beat_ms
        self._opened = 0
        self._peer = Peer()
        self._task = ""
        self._busy = threading.Lock()

    @property
    def layout(self) -> Layout | None:
        """The layout of ``msg``, or None before it is known."""
        return self._link.layout

    @property
    def xError(self) -> bool:
        """Whether ``udiError`` is not 0."""
        return self.udiError != 0

    @property
    def eError(self) -> ErrorNumber | None:
        """``udiError`` by its name; None while it is 0."""
        return ErrorNumber(self.udiError) if self.udiError else None

    @contextmanager
    def _entered(self) -> Iterator[Scan | None]:
        """Give the scan that the call belongs to; None if another task owns the instance or is inside."""
        scan = current_scan()
        if not self._busy.acquire(blocking=False):
            self.udiReentries += 1
            yield None
            return
        try:
            self._task = self._task or scan.task
            foreign = bool(scan.task) and self._task != scan.task
            self.udiReentries += foreign
            yield None if foreign else scan
        finally:
            self._busy.release()

    def _refuse(self) -> bool:
        """Report a call that was turned away."""
        self.udiError, self.reason = ErrorNumber.REENTERED.value, "the instance belongs to another task"
        return False

    def _report_silence(self) -> None:
        if self.udiError == 0 and self._peer.silent:
            self.udiError, self.reason = ErrorNumber.PEER_SILENT.value, "the bridge does not beat"
