"""ROS → PLC over classic memory: the newest message is written under the lock."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from dataclasses import dataclass

from rosplc._core._native import Fault
from rosplc.bridge.classic import ClassicSide
from rosplc.bridge.status import ClassicStatus
from rosplc.bridge.to_plc import ToPlc
from rosplc.bridge.topic import Surroundings
from rosplc.codec import TRUNCATED
from rosplc.config.resolve import TopicPlan
from rosplc.errors import ChannelError
from rosplc.shm.classic import Entry

__all__ = ["ClassicToPlc"]

_PERIOD_NS = 1_000_000
"""Time between attempts once ``wait`` is over."""


@dataclass(frozen=True)
class _Ready:
    data: bytes
    record: bytes
    truncated: bool


class ClassicToPlc(ToPlc):
    """One classic topic towards the PLC; :meth:`turn` is called by the carrier's thread.

    Args:
        plan: As for :class:`Topic`.
        around: As for :class:`Topic`.
        wake: Called, from any thread, when a message is to be written.
    """

    def __init__(self, plan: TopicPlan, around: Surroundings, wake: Callable[[], None]) -> None:
        super().__init__(plan, around, lambda _: None)
        self._gate = None
        self._side = ClassicSide(plan, around, self)
        self._wake_carrier = wake
        self._pending: bytes | None = None  # as it came
        self._pending_lock = threading.Lock()
        self._ready: _Ready | None = None  # converted, waiting for the lock
        self._late = False  # what waits could not be written in time
        self._replaced = 0
        self._try_at_ns = 0
        self.peer_alive = None

    def open(self) -> None:
        """Claim the memory. Raises as :meth:`ClassicSide.open`."""
        self._side.open()

    def close(self) -> None:
        """Leave memory and semaphore as they stand."""
        self._side.close()

    @property
    def due_ns(self) -> int | None:
        """Nothing waits for the keeper: the carrier knows what is due."""
        return None

    def check(self, now_ns: int) -> bool:
        """Count; the object is looked after by the carrier."""
        self._count_rate(now_ns)
        return False

    def on_message(self, data: bytes, stamp_ns: int) -> None:
        """Take a message from the backend; the newest alone waits to be written."""
        self.counters.received += 1
        self._hear(time.monotonic_ns())
        with self._pending_lock:
            if self._pending is not None:
                self._superseded()
            self._pending = data
        self._wake_carrier()

    def turn(self, now_ns: int) -> int:
        """Write what waits. Returns when the next turn is wanted."""
        try:
            return self._turn(now_ns)
        except (ChannelError, OSError, ValueError) as error:
            self._side.fail(now_ns, error)
            self._late = True
            return self._side.next_ns(now_ns)

    def _turn(self, now_ns: int) -> int:
        side = self._side
        replaced, _ = side.tend(now_ns)
        if replaced:
            self._attached()
        due = side.next_ns(now_ns)
        if not side.attached:
            self._late = True
            return due
        if now_ns >= self._try_at_ns and self._fetch(now_ns):
            self._try_at_ns = self._try(now_ns)
        waiting = self._ready is not None or self._pending is not None
        return min(due, self._try_at_ns) if waiting else due

    def _fetch(self, now_ns: int) -> bool:
        """Convert the newest message before the lock is taken; return whether something is to be written."""
        with self._pending_lock:
            data, self._pending = self._pending, None
        if data is None:
            return self._ready is not None
        try:
            record, cut = self.codec.plan.decode(data, self.plan.truncate)
        except Fault as fault:
            self.counters.refused += 1
            error = self.codec.explain(fault)
            self.note(now_ns, f"message refused: {error.where}: {error.what}", error.code)
            return self._ready is not None
        if self._ready is not None:
            self._superseded()
        self._ready = _Ready(data, record, bool(cut & TRUNCATED))
        if self.plan.on_change and record == self._last_record:
            self.counters.unchanged += 1
            self._ready = None
        return self._ready is not None

    def _try(self, now_ns: int) -> int:
        side, ready = self._side, self._ready
        assert ready is not None
        if side.enter(now_ns) is not Entry.ENTERED:
            self._late = True
            return side.again_ns(now_ns, _PERIOD_NS)
        try:
            side.object.write(ready.record)
        finally:
            side.object.leave()
        if not side.object.in_place():
            # Written into an object that nobody finds any more: once again into its successor.
            if side.follow(now_ns):
                self._attached()
            return now_ns
        self._ready, self._late = None, False
        self._last_record = ready.record
        self.counters.published += 1
        self.counters.truncated += ready.truncated
        if self.plan.print and ready.data:
            self._print(ready.data)
        return now_ns + self.plan.min_interval_ns

    def _superseded(self) -> None:
        if self._late:
            self.counters.lost += 1
        else:
            self._replaced += 1

    def _attached(self) -> None:
        last, self._last_record = self._last_record, None
        self._try_at_ns = 0
        if not self._side.same and self._side.plan.retained and self._ready is None and last is not None:
            self._ready = _Ready(b"", last, False)

    def _loss(self, count: int) -> str:
        return f"{count} messages were lost: the lock was not free, or there was no memory"

    def _skipped(self) -> int:
        return self.counters.unchanged + self._replaced

    def classic_status(self, now_ns: int) -> ClassicStatus:
        """Return what can be known of memory and lock."""
        return self._side.status(now_ns)
