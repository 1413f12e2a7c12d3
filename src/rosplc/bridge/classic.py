"""What both directions of a classic topic share, and the thread that carries them.

One thread per direction looks after all classic topics of it and never waits for a lock: a topic
whose lock is taken is tried again a moment later, so that one that is held delays no other.
"""

from __future__ import annotations

import logging
import random
import threading
import time
from collections import deque
from typing import Protocol

from rosplc.bridge.order import Order
from rosplc.bridge.status import ClassicStatus
from rosplc.bridge.topic import Surroundings, Topic, log
from rosplc.config.classic_plan import ClassicPlan
from rosplc.config.quantities import format_duration
from rosplc.config.resolve import TopicPlan
from rosplc.errors import ChannelError
from rosplc.shm import Direction
from rosplc.shm.classic import ClassicObject, Entry

__all__ = ["LOOK_NS", "Carried", "ClassicCarrier", "ClassicSide"]

LOOK_NS = 50_000_000
"""How often names and lock are looked at while nothing else leads there."""
_AGAIN_NS = 100_000
"""Time between two attempts within ``wait``."""
_RETURN_NS = 10_000_000_000
"""How long after a recovery the lock is looked at often: a holder that was only slow leaves it again."""
_SETTLING_NS = 300_000_000
"""How long objects may be half made before that is a problem: their makers make them in steps."""


class ClassicSide:
    """The object of a classic topic with its state; used by the carrier's thread alone.

    Args:
        plan: The topic's plan, with ``classic`` set.
        around: What the bridge's topics share.
        topic: Whose notes are written.

    Attributes:
        object: The memory with its lock.
        timeouts: Attempts to take the lock that did not succeed in time.
        fresh: Whether the memory appeared while this side was watching its name.
        same: Whether the memory is that of the attachment before: the semaphore alone was replaced.
        abandoned: Whether the lock that was replaced was taken when it was left.
    """

    def __init__(self, plan: TopicPlan, around: Surroundings, topic: Topic) -> None:
        assert plan.classic is not None
        self.plan: ClassicPlan = plan.classic
        self.timeouts = 0
        self.fresh = self.same = self.abandoned = False
        self.object = ClassicObject(
            self.plan.name,
            self.plan.semaphore,
            plan.layout.size,
            write=plan.direction is Direction.TO_PLC,
            recover_after_ns=self.plan.recover_after_ns,
            mode=around.mode,
            uid=around.uid,
            gid=around.gid,
        )
        self._topic = topic
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
        """Whether there is an object to carry to or from."""
        return self.object.memory is not None

    def open(self) -> None:
        """Keep other bridges away, and attach if that is possible already.

        Raises:
            ChannelError: SHM116 if another bridge has the memory; and what keeps a lock file from
                being made. That the memory itself cannot be used is a problem of the topic alone.
        """
        self.object.claim()
        self._attach(time.monotonic_ns())

    def close(self) -> None:
        """Leave memory and semaphore as they stand."""
        self.object.close()

    def tend(self, now_ns: int) -> tuple[bool, bool]:
        """Attach, notice a replacement, judge the lock.

        Returns:
            Whether another object is attached now; whether the lock was freed for a dead holder.
        """
        if not self.attached:
            return (now_ns >= self._retry_ns and self._attach(now_ns)), False
        if now_ns < self._look_ns:
            return False, False
        self._look_ns = _next_look(now_ns)
        if not self.object.in_place():
            return self.follow(now_ns), False
        entry = self.object.look(now_ns)
        self._judge(entry, now_ns)
        return False, entry is Entry.RECOVERED

    def follow(self, now_ns: int) -> bool:
        """Attach to what the names lead to now; return whether there is something."""
        lock = self.object.lock
        self.abandoned = lock is not None and lock.value == 0
        log.info("%s: memory or semaphore %s was replaced", self._topic.plan.topic, self.plan.name)
        return self._attach(now_ns)

    def fail(self, now_ns: int, error: ChannelError | OSError | ValueError) -> None:
        """Let go of an object that cannot be used, and try again in a moment."""
        self.object.detach()
        self._retry_ns = now_ns + LOOK_NS
        if self._failing_since_ns is None:
            self._failing_since_ns = now_ns
        if now_ns - self._failing_since_ns >= _SETTLING_NS or not isinstance(error, ChannelError):
            self._topic.fail(now_ns, error)

    def enter(self, now_ns: int, *, alive: bool = False) -> Entry:
        """Try to take the lock; BUSY is counted once ``wait`` is over."""
        entry = self.object.enter(now_ns, alive=alive)
        self._judge(entry, now_ns)
        if entry is Entry.ENTERED:
            self._trying_since_ns = None
        elif entry is Entry.BUSY:
            if self._trying_since_ns is None:
                self._trying_since_ns = now_ns
            elif self._trying_since_ns >= 0 and now_ns - self._trying_since_ns >= self.plan.wait_ns:
                self._trying_since_ns = -1  # counted: from now on seldom
                self.timeouts += 1
                words = f"the lock was not free within {format_duration(self.plan.wait_ns)}"
                self._topic.note(now_ns, words, "SHM127")
        return entry

    def again_ns(self, now_ns: int, period_ns: int) -> int:
        """Return when to try the lock again: soon within ``wait``, then with the period."""
        # Never in step with a PLC's cycle: looks that always fall into its turn would see a dead holder.
        if self._trying_since_ns is not None and self._trying_since_ns < 0:
            return now_ns + period_ns // 2 + random.randrange(period_ns)
        return now_ns + _AGAIN_NS // 2 + random.randrange(_AGAIN_NS)

    def next_ns(self, now_ns: int) -> int:
        """Return when :meth:`tend` wants to be called again."""
        if not self.attached:
            return self._retry_ns
        lock = self.object.lock
        if lock is not None and (lock.held_since_ns is not None or now_ns < self._often_until_ns):
            # Taken at the last look: look often, since a holder is called dead by many looks alone.
            self._look_ns = min(self._look_ns, now_ns + random.randrange(1_000_000, 3_000_000))
        return self._look_ns

    def status(self, now_ns: int) -> ClassicStatus:
        """Return what can be known of memory and lock; from any thread."""
        memory, lock = self.object.memory, self.object.lock
        held = lock.held_since_ns if lock is not None else None
        return ClassicStatus(
            memory=self.plan.name,
            semaphore=self.plan.semaphore,
            bytes=memory.size if memory is not None else 0,
            attached=memory is not None,
            held_ns=0 if held is None else max(0, now_ns - held),
            timeouts=self.timeouts,
            recovered=self.object.recovered,
            mended=self.object.mended,
        )

    def _attach(self, now_ns: int) -> bool:
        before = self._identity
        try:
            self.object.attach()
        except (ChannelError, OSError, ValueError) as error:
            self.fail(now_ns, error)
            self._watched = self._watched or getattr(error, "code", "") == "SHM129"
            return False
        self._failing_since_ns = None
        memory, lock = self.object.memory, self.object.lock
        assert memory is not None
        self._identity = memory.identity
        self.same = memory.identity == before
        self.fresh = memory.created or self._watched
        self._watched = True
        self._look_ns = _next_look(now_ns)
        self._topic.problem = ""
        if memory.odd_size:
            words = f"the memory has {memory.size} bytes, the record {memory.record_size}"
            self._topic.note(now_ns, words, "SHM130")
        made = [kind for kind, thing in (("memory", memory), ("semaphore", lock)) if thing and thing.created]
        level = logging.INFO if self.object.attachments == 1 else logging.DEBUG
        how = f"{' and '.join(made)} made here" if made else "made by the other side"
        log.log(level, "%s: attached to %s (%s)", self._topic.plan.topic, self.plan.name, how)
        return True

    def _judge(self, entry: Entry, now_ns: int) -> None:
        if entry is Entry.RECOVERED:
            self._often_until_ns = now_ns + _RETURN_NS
            words = (
                f"semaphore {self.plan.semaphore} was locked for "
                f"{format_duration(self.plan.recover_after_ns)} without a sign of life and has been freed: "
                "its holder died inside, or it was created locked"
            )
            self._topic.note(now_ns, words, "SHM131")
        if self.object.mended > self._mended:
            self._mended = self.object.mended
            words = f"semaphore {self.plan.semaphore} let in more than one; corrected"
            self._topic.note(now_ns, words, "SHM132")


def _next_look(now_ns: int) -> int:
    # On one grid all topics share a wake-up: looks are most of what quiet topics cost.
    return now_ns - now_ns % LOOK_NS + LOOK_NS


class Carried(Protocol):
    """A classic topic as the carrier sees it."""

    plan: TopicPlan

    def turn(self, now_ns: int) -> int:
        """Do what is due; return when the next turn is wanted."""
        ...


class ClassicCarrier:
    """The thread of the classic topics of one direction.

    Args:
        name: The thread's name.

    Attributes:
        busy_since_ns: When it began the turn that runs; 0 while it waits.
    """

    def __init__(self, name: str) -> None:
        self.busy_since_ns = 0
        self._topics: tuple[Carried, ...] = ()
        self._wake = threading.Event()
        self._orders: deque[Order] = deque()
        self._stopping = False
        self._thread = threading.Thread(target=self._run, name=name, daemon=True)

    def start(self, topics: tuple[Carried, ...]) -> None:
        """Begin to carry; without topics there is no thread until some come."""
        self._topics = topics
        if topics:
            self._thread.start()

    def replace(self, topics: tuple[Carried, ...]) -> bool:
        """Carry these topics from now on; from any thread but its own.

        Returns:
            False if the thread hangs in the ROS side; nothing has changed then. Otherwise it touches
            the others no more.
        """
        if not self._thread.is_alive():
            self.start(topics)
            return True
        order = Order(lambda: setattr(self, "_topics", topics))
        self._orders.append(order)
        self.wake()
        return order.wait()

    def wake(self) -> None:
        """Something is to be carried: look again; from any thread."""
        self._wake.set()

    def stop(self, timeout: float = 5.0) -> bool:
        """End; return whether the thread ended in time."""
        self._stopping = True
        self._wake.set()
        if self._thread.is_alive():
            self._thread.join(timeout)
        return not self._thread.is_alive()

    def _run(self) -> None:
        while not self._stopping:
            self._wake.clear()
            while self._orders:
                self._orders.popleft()()
            self.busy_since_ns = time.monotonic_ns()
            due = self.busy_since_ns + LOOK_NS
            for topic in self._topics:
                due = min(due, self._turn(topic))
            self.busy_since_ns = 0
            wait = due - time.monotonic_ns()
            if wait > 0:
                self._wake.wait(wait / 1e9)

    def _turn(self, topic: Carried) -> int:
        now = time.monotonic_ns()
        try:
            return topic.turn(now)
        except Exception:  # one topic's trouble is no other's
            log.exception("%s: carrying failed; it goes on", topic.plan.topic)
            return now + LOOK_NS
