"""Ports over classic memory, a bare record guarded by a named semaphore: spec/classic-mode.md.

One thread per direction serves all ports. It never waits for a lock, but tries again later.
"""

from __future__ import annotations

import logging
import random
import threading
from abc import abstractmethod
from dataclasses import dataclass

from rosplc.bridge.port import Context, Port, Waiting, log
from rosplc.bridge.status import ClassicStatus, PortStatus
from rosplc.bridge.stream import Stream
from rosplc.codec import Fault
from rosplc.config.quantities import format_duration
from rosplc.errors import ChannelError
from rosplc.shm import Direction
from rosplc.shm.classic import ClassicObject, Entry

LOOK_NS = 50_000_000  # how often names and lock are looked at while nothing else leads there
_AGAIN_NS = 100_000  # time between two attempts within ``wait``
_PERIOD_NS = 1_000_000  # time between two attempts to write once ``wait`` is over
_RETURN_NS = 10_000_000_000
"""Time after a recovery in which the lock is checked often: a holder that was only slow releases it again."""
_SETTLING_NS = 300_000_000
"""How long objects may be incomplete before this is a problem: programs create them in several steps."""
_LAZY_POLL_NS = 10_000_000
_ALERT_NS = 10_000_000_000


class ClassicPort(Port):
    """The memory and lock of a classic stream, used by one thread; neither has a heartbeat."""

    adopted = True  # other programs use the memory too: it is never retired

    def __init__(self, side: Stream, context: Context) -> None:
        classic = side.plan.classic
        assert classic is not None
        self.side = side
        self._classic = classic
        self._clock = context.clock
        self._started_ns = context.clock.monotonic_ns()
        self._object = ClassicObject(
            classic.name,
            classic.semaphore,
            side.plan.layout.size,
            write=side.plan.direction is Direction.TO_PLC,
            recover_after_ns=classic.recover_after_ns,
            rights=context.rights,
        )
        self._replaced = 0  # messages that a newer one replaced
        self._timeouts = 0  # attempts to take the lock that did not succeed in time
        self._fresh = False  # the memory appeared while its name was watched
        self._same = False  # the memory is that of the attachment before: the semaphore alone was replaced
        self._abandoned = False  # the lock that was replaced was taken when it was left
        self._watched = False
        self._identity: tuple[int, int] | None = None
        self._retry_ns = 0
        self._look_ns = 0
        self._failing_since_ns: int | None = None
        self._trying_since_ns: int | None = None
        self._mended = 0
        self._often_until_ns = 0

    @property
    def attached(self) -> bool:
        """Whether an object is attached."""
        return self._object.memory is not None

    def open(self) -> None:
        """Keep other bridges away, and attach if this is already possible.

        Raises ChannelError SHM116 if another bridge has the memory, or the error of making the lock file. If
        the memory itself cannot be used, only this stream is affected.
        """
        self._object.claim()
        self._attach(self._clock.monotonic_ns())
        self._attached()

    def close(self) -> None:
        """Close memory and semaphore, which keep their last state."""
        self._object.close()

    def owned(self) -> bool:
        """Return whether the lock file is still this bridge's."""
        return self._object.owned()

    def turn(self, now_ns: int) -> int:
        """Do what is due; return when the next turn is due."""
        try:
            return self._turn(now_ns)
        except (ChannelError, OSError, ValueError) as error:
            self._fail(now_ns, error)
            return self._next_ns(now_ns)

    def status(self, now_ns: int) -> PortStatus:
        """Return what is known about the memory and lock, which have no heartbeat."""
        memory, lock = self._object.memory, self._object.lock
        held = lock.held_since_ns if lock is not None else None
        classic = ClassicStatus(
            memory=self._classic.name,
            semaphore=self._classic.semaphore,
            bytes=memory.size if memory is not None else 0,
            attached=memory is not None,
            held_ns=0 if held is None else max(0, now_ns - held),
            timeouts=self._timeouts,
            recovered=self._object.recovered,
            mended=self._object.mended,
        )
        return PortStatus(skipped=self._replaced, classic=classic, peer_alive=None)

    @abstractmethod
    def _turn(self, now_ns: int) -> int:
        """As :meth:`turn`; an error detaches the object."""

    @abstractmethod
    def _attached(self) -> None:
        """React to a newly attached object or lock."""

    def _tend(self, now_ns: int) -> bool:
        """Attach, follow a replacement, and check the lock; return whether it was freed for a dead holder."""
        if not self.attached:
            if now_ns >= self._retry_ns and self._attach(now_ns):
                self._attached()
            return False
        if now_ns < self._look_ns:
            return False
        self._look_ns = _next_look(now_ns)
        if not self._object.in_place():
            self._follow(now_ns)
            return False
        entry = self._object.look(now_ns)
        self._judge(entry, now_ns)
        return entry is Entry.RECOVERED

    def _follow(self, now_ns: int) -> None:
        """Attach to the objects that the names refer to now."""
        lock = self._object.lock
        self._abandoned = lock is not None and lock.value == 0
        log.info("%s: memory %s or its semaphore was replaced", self.side.plan.topic, self._classic.name)
        if self._attach(now_ns):
            self._attached()

    def _fail(self, now_ns: int, error: ChannelError | OSError | ValueError) -> None:
        """Detach an object that cannot be used, and try again in a moment."""
        self._object.detach()
        self._retry_ns = now_ns + LOOK_NS
        if self._failing_since_ns is None:
            self._failing_since_ns = now_ns
        if now_ns - self._failing_since_ns >= _SETTLING_NS or not isinstance(error, ChannelError):
            self.side.fail(now_ns, error)

    def _enter(self, now_ns: int, *, alive: bool = False) -> Entry:
        """Try to take the lock; BUSY is counted once ``wait`` is over."""
        entry = self._object.enter(now_ns, alive=alive)
        self._judge(entry, now_ns)
        if entry is Entry.ENTERED:
            self._trying_since_ns = None
        elif entry is Entry.BUSY:
            if self._trying_since_ns is None:
                self._trying_since_ns = now_ns
            elif self._trying_since_ns >= 0 and now_ns - self._trying_since_ns >= self._classic.wait_ns:
                self._trying_since_ns = -1  # counted: from now on seldom
                self._timeouts += 1
                words = f"the lock was not free within {format_duration(self._classic.wait_ns)}"
                self.side.note(now_ns, words, "SHM127")
        return entry

    def _again_ns(self, now_ns: int, period_ns: int) -> int:
        """Return when to try the lock again: soon within ``wait``, then once per period."""
        # Never in step with a PLC's cycle: looks that always fall into its turn would see a dead holder.
        if self._trying_since_ns is not None and self._trying_since_ns < 0:
            return now_ns + period_ns // 2 + random.randrange(period_ns)
        return now_ns + _AGAIN_NS // 2 + random.randrange(_AGAIN_NS)

    def _next_ns(self, now_ns: int) -> int:
        """Return when :meth:`_tend` is due again."""
        if not self.attached:
            return self._retry_ns
        lock = self._object.lock
        if lock is not None and (lock.held_since_ns is not None or now_ns < self._often_until_ns):
            # Taken at the last look: look often, since a holder is called dead by many looks alone.
            self._look_ns = min(self._look_ns, now_ns + random.randrange(1_000_000, 3_000_000))
        return self._look_ns

    def _attach(self, now_ns: int) -> bool:
        before = self._identity
        try:
            self._object.attach()
        except (ChannelError, OSError, ValueError) as error:
            self._fail(now_ns, error)
            self._watched = self._watched or getattr(error, "code", "") == "SHM129"
            return False
        self._failing_since_ns = None
        memory, lock = self._object.memory, self._object.lock
        assert memory is not None
        self._identity = memory.identity
        self._same = memory.identity == before
        self._fresh = memory.created or self._watched
        self._watched = True
        self._look_ns = _next_look(now_ns)
        self.side.problem = ""
        if memory.odd_size:
            words = f"the memory has {memory.size} bytes, but the record has {memory.record_size}"
            self.side.note(now_ns, words, "SHM130")
        made = [kind for kind, thing in (("memory", memory), ("semaphore", lock)) if thing and thing.created]
        level = logging.INFO if self._object.attachments == 1 else logging.DEBUG
        how = f"{' and '.join(made)} created by the bridge" if made else "created by the other side"
        log.log(level, "%s: attached to %s (%s)", self.side.plan.topic, self._classic.name, how)
        return True

    def _judge(self, entry: Entry, now_ns: int) -> None:
        if entry is Entry.RECOVERED:
            self._often_until_ns = now_ns + _RETURN_NS
            words = (
                f"semaphore {self._classic.semaphore} was locked for "
                f"{format_duration(self._classic.recover_after_ns)} without a sign of life and has been "
                "freed: its holder died, or it was created locked"
            )
            self.side.note(now_ns, words, "SHM131")
        if self._object.mended > self._mended:
            self._mended = self._object.mended
            words = f"the value of semaphore {self._classic.semaphore} was above 1 and has been corrected"
            self.side.note(now_ns, words, "SHM132")


def _next_look(now_ns: int) -> int:
    # On one grid all ports share a wake-up: looks are most of what quiet streams cost.
    return now_ns - now_ns % LOOK_NS + LOOK_NS


@dataclass(frozen=True)
class _Ready:
    data: bytes
    record: bytes
    flags: int


class ClassicToPlc(ClassicPort):
    """A memory to which the bridge writes the newest message while it holds the lock."""

    def __init__(self, side: Stream, context: Context, ports: ClassicPorts) -> None:
        super().__init__(side, context)
        self._ports = ports
        self._pending: bytes | None = None  # as it came
        self._pending_lock = threading.Lock()
        self._ready: _Ready | None = None  # converted, waiting for the lock
        self._last: bytes | None = None  # what was written
        self._late = False  # what waits could not be written in time
        self._try_at_ns = 0

    def put(self, data: bytes, stamp_ns: int, flags: int, now_ns: int) -> None:
        """Store a message to be written soon; only the newest message waits."""
        with self._pending_lock:
            if self._pending is not None:
                self._superseded()
            self._pending = data
        self._ports.wake()

    def loss(self, count: int) -> str:
        """Describe why messages were lost."""
        return f"{count} messages were lost: the lock was not free, or the shared memory did not exist"

    def _turn(self, now_ns: int) -> int:
        self._tend(now_ns)
        due = self._next_ns(now_ns)
        if not self.attached:
            self._late = True
            return due
        if now_ns >= self._try_at_ns and self._fetch(now_ns):
            self._try_at_ns = self._try(now_ns)
        waiting = self._ready is not None or self._pending is not None
        return min(due, self._try_at_ns) if waiting else due

    def _fail(self, now_ns: int, error: ChannelError | OSError | ValueError) -> None:
        super()._fail(now_ns, error)
        self._late = True

    def _fetch(self, now_ns: int) -> bool:
        """Convert the newest message before taking the lock; return whether there is anything to write."""
        with self._pending_lock:
            data, self._pending = self._pending, None
        if data is None:
            return self._ready is not None
        try:
            record, cut = self.side.codec.plan.decode(data, self.side.plan.truncate)
        except Fault as fault:
            self.side.refuse(fault, now_ns)
            return self._ready is not None
        if self._ready is not None:
            self._superseded()
        self._ready = _Ready(data, record, cut)
        return True

    def _try(self, now_ns: int) -> int:
        ready = self._ready
        assert ready is not None
        if self._enter(now_ns) is not Entry.ENTERED:
            self._late = True
            return self._again_ns(now_ns, _PERIOD_NS)
        try:
            if not self.owned():  # resumed after a stop: what waited here is older than what is there now
                self._ready = None
                self.side.counters.lost += 1
                return now_ns
            self._object.write(ready.record)
        finally:
            self._object.leave()
        if not self._object.in_place():
            # Written into an object that nobody finds any more: once again into its successor.
            self._follow(now_ns)
            return now_ns
        self._ready, self._late = None, False
        self._last = ready.record
        if ready.data:
            self.side.delivered(ready.data, ready.flags)
        else:
            self.side.counters.published += 1
        return now_ns

    def _superseded(self) -> None:
        if self._late:
            self.side.counters.lost += 1
        else:
            self._replaced += 1

    def _attached(self) -> None:
        last, self._last = self._last, None
        self._try_at_ns = 0
        self.side.renewed()
        if not self._same and self.side.plan.latched and self._ready is None and last is not None:
            self._ready = _Ready(b"", last, 0)


class ClassicToRos(ClassicPort):
    """A memory that the bridge reads: a changed record is a message."""

    def __init__(self, side: Stream, context: Context) -> None:
        super().__init__(side, context)
        self._poll_ns = self._classic.poll_ns
        self._poll_at_ns = 0
        self._image: bytes | None = None  # None: what is in the memory is not known yet
        self._seen = b""
        self._distrusted: bytes | None = None
        self._message_ns = self._started_ns

    def loss(self, count: int) -> str:
        """Describe why messages were lost."""
        return f"{count} messages were lost: ROS did not accept them, or their writer died"

    def _turn(self, now_ns: int) -> int:
        if self._tend(now_ns):
            self._distrust()
        if not self.attached:
            return self._next_ns(now_ns)
        if now_ns >= self._poll_at_ns:
            self._poll_at_ns = self._look(now_ns)
        return min(self._poll_at_ns, self._next_ns(now_ns))

    def _look(self, now_ns: int) -> int:
        peeked = self._object.peek()
        if peeked == self._image and self.side.plan.on_change:
            return self._next_poll(now_ns)
        moved, self._seen = peeked != self._seen, peeked
        entry = self._enter(now_ns, alive=moved)
        if entry is Entry.RECOVERED:
            self._distrust()
        if entry is not Entry.ENTERED:
            return self._again_ns(now_ns, self._poll_ns)
        try:
            image = self._object.read()
        finally:
            self._object.leave()
        if not self._object.in_place():
            # Replaced meanwhile: its writer may have held another lock than this one.
            self._follow(now_ns)
            return now_ns
        if image is None:
            return self._again_ns(now_ns, self._poll_ns)
        self._take(image, now_ns)
        return self._next_poll(now_ns)

    def _take(self, image: bytes, now_ns: int) -> None:
        before, self._image = self._image, image
        if image == self._distrusted:
            return
        self._distrusted = None
        if self.side.plan.on_change:
            if before is None and not self.side.plan.latched:
                return  # what was there before does not tell when it was written
            if image == before or (before is None and not any(image)):
                return
        self._message_ns = now_ns
        self.side.receive(self.side.codec.encode(image), 0, 0, 0)

    def _attached(self) -> None:
        """Forget the previous object's content; a newly created object starts with zeros."""
        self._poll_at_ns = 0
        if not self._same:
            self._image = bytes(self.side.plan.layout.size) if self._fresh else None
            self._seen, self._distrusted = b"", None
        elif self._abandoned:
            self._distrust()  # the semaphore may have been replaced for one that died inside the old

    def _distrust(self) -> None:
        """Treat the content as read: its writer may have died while writing. The next change counts."""
        image = self._object.peek()
        if self._image is not None and image != self._image:
            self.side.counters.lost += 1
        self._image = self._distrusted = image

    def _next_poll(self, now_ns: int) -> int:
        period = self._poll_ns
        if self.side.plan.on_change and now_ns - self._message_ns > _ALERT_NS:
            period = max(period, _LAZY_POLL_NS)
        # On one grid all ports share a wake-up.
        return now_ns - now_ns % period + period


class ClassicPorts(Waiting[ClassicPort]):
    """The classic ports of one direction."""

    def __init__(self, context: Context, direction: Direction) -> None:
        super().__init__(context)
        self._direction = direction
        self._ports: list[ClassicPort] = []

    def make(self, side: Stream) -> ClassicPort:
        """Return the port of a stream."""
        if self._direction is Direction.TO_PLC:
            return ClassicToPlc(side, self._context, self)
        return ClassicToRos(side, self._context)

    def add(self, port: ClassicPort) -> None:
        """Start to serve an open port."""
        self._ports.append(port)

    def remove(self, port: ClassicPort) -> None:
        """Stop serving the port."""
        if port in self._ports:
            self._ports.remove(port)

    def take(self, now_ns: int) -> tuple[int | None, list[ClassicPort]]:
        """Give each port its turn."""
        due = None
        for port in self._ports:
            try:
                wanted = port.turn(self._context.clock.monotonic_ns())
            except Exception:  # one stream's trouble is no other's
                log.exception("%s: carrying messages failed; the bridge continues", port.side.plan.topic)
                wanted = now_ns + LOOK_NS
            due = wanted if due is None else min(due, wanted)
        return due, []
