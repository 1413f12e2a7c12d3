"""PLC → ROS over classic memory: a changed image is a message."""

from __future__ import annotations

from rosplc.bridge.classic import ClassicSide
from rosplc.bridge.status import ClassicStatus
from rosplc.bridge.to_ros import ToRos
from rosplc.bridge.topic import Surroundings
from rosplc.config.resolve import TopicPlan
from rosplc.errors import ChannelError
from rosplc.shm.classic import Entry

__all__ = ["ClassicToRos"]

_LAZY_POLL_NS = 10_000_000
_ALERT_NS = 10_000_000_000


class ClassicToRos(ToRos):
    """One classic topic towards ROS; :meth:`turn` is called by the carrier's thread."""

    def __init__(self, plan: TopicPlan, around: Surroundings) -> None:
        super().__init__(plan, around)
        self._gate = None  # what waits for its time stands in the memory itself
        self._side = ClassicSide(plan, around, self)
        assert plan.classic is not None
        self._poll_ns = plan.classic.poll_ns
        self._poll_at_ns = 0
        self._open_ns = 0
        self._last: bytes | None = None  # None: what stands there is not known yet
        self._seen = b""
        self._distrusted: bytes | None = None
        self.peer_alive = None

    def open(self) -> None:
        """Claim the memory. Raises as :meth:`ClassicSide.open`."""
        self._side.open()
        self._attached()

    def close(self) -> None:
        """Leave memory and semaphore as they stand."""
        self._side.close()

    def check(self, now_ns: int) -> bool:
        """Count; the object is looked after by the carrier."""
        self._count_rate(now_ns)
        return False

    def turn(self, now_ns: int) -> int:
        """Look at the memory; publish what is new. Returns when to look again."""
        try:
            return self._turn(now_ns)
        except (ChannelError, OSError, ValueError) as error:
            self._side.fail(now_ns, error)
            return self._side.next_ns(now_ns)

    def _turn(self, now_ns: int) -> int:
        side = self._side
        if self.due_ns is not None:
            self.flush(now_ns)
        replaced, freed = side.tend(now_ns)
        if replaced:
            self._attached()
        if freed:
            self._distrust()
        if not side.attached:
            return side.next_ns(now_ns)
        if now_ns >= self._poll_at_ns:
            self._poll_at_ns = self._poll(now_ns)
        due = min(self._poll_at_ns, side.next_ns(now_ns))
        return due if self.due_ns is None else min(due, self.due_ns)

    def _poll(self, now_ns: int) -> int:
        side, classic = self._side, self._side.object
        if now_ns < self._open_ns:
            return self._open_ns
        peeked = classic.peek()
        if peeked == self._last and self.plan.on_change:
            return self._next_poll(now_ns)
        moved, self._seen = peeked != self._seen, peeked
        entry = side.enter(now_ns, alive=moved)
        if entry is Entry.RECOVERED:
            self._distrust()
        if entry is not Entry.ENTERED:
            return side.again_ns(now_ns, self._poll_ns)
        try:
            image = classic.read()
        finally:
            classic.leave()
        if not classic.in_place():
            # Replaced meanwhile: whoever wrote may have held another lock than this one.
            if side.follow(now_ns):
                self._attached()
            return now_ns
        if image is None:
            return side.again_ns(now_ns, self._poll_ns)
        self._take(image, now_ns)
        return self._next_poll(now_ns)

    def _take(self, image: bytes, now_ns: int) -> None:
        before, self._last = self._last, image
        if image == self._distrusted:
            return
        self._distrusted = None
        if self.plan.on_change:
            if before is None and not self._side.plan.retained:
                return  # what stood there before says nothing about when it was written
            if image == before or (before is None and not any(image)):
                return
        self._open_ns = now_ns + self.plan.min_interval_ns
        self.on_message(self.codec.encode(image), 0, 0, 0)

    def _attached(self) -> None:
        """Know nothing of another object, but that a new one began with zeros."""
        side = self._side
        self._poll_at_ns = 0
        if not side.same:
            self._last = bytes(self.plan.layout.size) if side.fresh else None
            self._seen, self._distrusted = b"", None
        elif side.abandoned:
            self._distrust()  # whoever replaced the semaphore may follow one that died inside the old

    def _distrust(self) -> None:
        """Take what stands there now for read: its writer may have died half-way; the next change counts."""
        image = self._side.object.peek()
        if self._last is not None and image != self._last:
            self.counters.lost += 1
        self._last = self._distrusted = image

    def _next_poll(self, now_ns: int) -> int:
        period = self._poll_ns
        quiet = self.last_ns is None or now_ns - self.last_ns > _ALERT_NS
        if quiet and self.plan.on_change and now_ns - self._started_ns > _ALERT_NS:
            period = max(period, _LAZY_POLL_NS)
        # On one grid all topics share a wake-up.
        return max(self._open_ns, now_ns - now_ns % period + period)

    def _loss(self, count: int) -> str:
        return f"{count} messages were lost: not taken by ROS, or perhaps half written by one that died"

    def classic_status(self, now_ns: int) -> ClassicStatus:
        """Return what can be known of memory and lock."""
        return self._side.status(now_ns)
