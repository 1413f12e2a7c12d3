"""A pipeline of stages that can hold messages back, and the detection of a silent source.

A message passes through the stages in order. A stage lets it through, drops it, or keeps it until a time
(``due_ns``). When a kept message is flushed, it continues with the next stage.
"""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Callable, Sequence

Item = tuple[bytes, int]  # a message's wire bytes and its stamp, ns since 1970

GRACE_NS = 1_000_000_000  # how long after the start messages to ROS may wait for the first subscriber

_LOOK_NS = 5_000_000
_RETRY_NS = 500_000_000


class Silence:
    """How long a source has been silent, and whether its silence is to be reported."""

    def __init__(self, limit_ns: int, debounce_ns: int, now_ns: int) -> None:
        self.last_ns: int | None = None
        self._since_ns = now_ns
        self._limit_ns = limit_ns  # age at which the last message counts as stale; 0 for never
        self._debounce_ns = debounce_ns  # how much longer silence must last, and how long its end
        self._settled_ns = 0  # when a silence that was reported counts as over

    def heard(self, now_ns: int) -> bool:
        """Note that a message arrived; return whether the source was stale before."""
        gap, limit = now_ns - self._since_ns, self._limit_ns
        self.last_ns = self._since_ns = now_ns
        if not limit or gap <= limit:
            return False
        if gap > limit + self._debounce_ns or now_ns < self._settled_ns:
            self._settled_ns = now_ns + self._debounce_ns
        return True

    def passed(self, last_ns: int) -> None:
        """Note the time of the last message that bypassed :meth:`heard`; all were within the limit."""
        if self.last_ns is not None and last_ns > self.last_ns:
            self.last_ns = self._since_ns = last_ns

    def excuse(self, now_ns: int) -> None:
        """Restart the time limit: until now, another bridge received the source's messages."""
        self._since_ns = now_ns

    @property
    def due_ns(self) -> int:
        """The time at which the source becomes stale if no message arrives."""
        return self._since_ns + self._limit_ns

    def stale(self, now_ns: int) -> bool:
        """Return whether the last message is older than the limit."""
        return bool(self._limit_ns) and now_ns > self.due_ns

    def reported(self, now_ns: int) -> bool:
        """Return the same, debounced, as it is reported."""
        late = now_ns > self.due_ns + self._debounce_ns
        return bool(self._limit_ns) and (late or now_ns < self._settled_ns)

    def age_ns(self, now_ns: int) -> int | None:
        """Return the time since the last message; None before the first."""
        return None if self.last_ns is None else max(0, now_ns - self.last_ns)


class Stage:
    """One reason to hold messages back; the base class lets all messages through."""

    due_ns: int | None = None  # when :meth:`flush` wants to be called; None if nothing waits
    skipped = 0  # messages that were held back for good, on purpose
    over = False  # whether the stage has become useless and can be left out from now on
    clears = False  # whether everything else is sent before its own time

    def offer(self, item: Item, now_ns: int) -> Sequence[Item]:
        """Accept a message; return the messages that may continue now."""
        return (item,)

    def flush(self, now_ns: int, *, anyway: bool = False) -> Sequence[Item]:
        """Return the waiting messages that may continue now; with ``anyway``, all of them."""
        return ()

    def forget(self) -> None:
        """Note that the receiver does not have the last message."""


class Hold:
    """The stages of one stream, in order; ``send`` gets what has passed all of them. Thread-safe."""

    def __init__(self, stages: Sequence[Stage], send: Callable[[bytes, int, int], None]) -> None:
        self.stages = list(stages)
        self._send = send
        self._skipped = 0  # of stages that are over
        self._lock = threading.RLock()

    @property
    def due_ns(self) -> int | None:
        """When :meth:`flush` is due; None if nothing is waiting."""
        return min((due for stage in self.stages if (due := stage.due_ns) is not None), default=None)

    @property
    def skipped(self) -> int:
        """Number of messages that were held back intentionally."""
        return self._skipped + sum(stage.skipped for stage in self.stages)

    def offer(self, item: Item, now_ns: int) -> bool:
        """Send a message, or hold it back; return whether a message is waiting now."""
        with self._lock:
            before = self.due_ns
            self._pass(0, [item], now_ns)
            return before is None and self.due_ns is not None

    def flush(self, now_ns: int, *, anyway: bool = False) -> None:
        """Send the waiting messages that are due; with ``anyway``, all of them."""
        with self._lock:
            # What the PLC sent comes before what takes its place.
            anyway = anyway or any(stage.clears and (stage.due_ns or 0) <= now_ns for stage in self.stages)
            for number, stage in enumerate(self.stages):
                due = stage.due_ns
                if anyway or (due is not None and due <= now_ns):
                    self._pass(number + 1, stage.flush(now_ns, anyway=anyway), now_ns)
            self._skipped += sum(stage.skipped for stage in self.stages if stage.over)
            self.stages = [stage for stage in self.stages if not stage.over]

    def _pass(self, start: int, items: Sequence[Item], now_ns: int) -> None:
        for stage in self.stages[start:]:
            items = [passed for item in items for passed in stage.offer(item, now_ns)]
        for data, stamp_ns in items:
            self._send(data, stamp_ns, now_ns)

    def forget(self) -> None:
        """Note that the receiver does not have the last message: an identical message is new to it."""
        for stage in self.stages:
            stage.forget()


class OnChange(Stage):
    """Lets a message through if its key differs from that of the previous message, or if it has no key."""

    def __init__(self, key: Callable[[bytes], bytes | None] = lambda data: data) -> None:
        self.last: bytes | None = None
        self._key = key

    def offer(self, item: Item, now_ns: int) -> Sequence[Item]:
        """Accept a message; return it if it is new."""
        key = self._key(item[0])
        if key is not None:
            if key == self.last:
                self.skipped += 1
                return ()
            self.last = key
        return (item,)

    def forget(self) -> None:
        """Treat an identical message as new."""
        self.last = None


class RateLimiter(Stage):
    """Lets one message through per interval; the newest one waits, so the last is never dropped."""

    def __init__(self, interval_ns: int) -> None:
        self._interval_ns = interval_ns
        self._open_ns: int | None = None
        self._waiting: Item | None = None

    def offer(self, item: Item, now_ns: int) -> Sequence[Item]:
        """Return the message if it may pass now; otherwise keep it."""
        if self._waiting is not None:
            self.skipped += 1
        if self._open_ns is None or now_ns >= self._open_ns:
            self.due_ns = self._waiting = None
            self._open_ns = now_ns + self._interval_ns
            return (item,)
        self._waiting, self.due_ns = item, self._open_ns
        return ()

    def flush(self, now_ns: int, *, anyway: bool = False) -> Sequence[Item]:
        """Return the waiting message if it is due."""
        item = self._waiting
        if item is None or self.due_ns is None or (now_ns < self.due_ns and not anyway):
            return ()
        self._waiting = self.due_ns = None
        self._open_ns = now_ns + self._interval_ns
        return (item,)


class Grace(Stage):
    """Holds back the first messages of a topic to ROS for a moment, until a subscriber is connected.

    If a PLC writes while the bridge is down, the bridge finds the message as soon as it starts, but
    subscribers need a few hundred milliseconds to discover the bridge. A volatile one would miss the message.
    """

    def __init__(self, until_ns: int, most: int, matched: Callable[[], bool]) -> None:
        self.due_ns = until_ns
        self._until_ns = until_ns
        self._most = most  # how many messages may wait; with 1 the newest alone
        self._matched = matched  # whether there is a subscriber; asked only while something waits
        self._held: deque[Item] = deque()

    def offer(self, item: Item, now_ns: int) -> Sequence[Item]:
        """Keep a message; return all messages if the wait is over or no more messages may wait."""
        full = len(self._held) == self._most
        if (full and self._most > 1) or self._ends(now_ns):
            self.due_ns = now_ns  # to be left out
            return (*self._release(), item)
        if full:
            self._held.clear()
            self.skipped += 1
        self._held.append(item)
        self.due_ns = min(now_ns + _LOOK_NS, self._until_ns)
        return ()

    def flush(self, now_ns: int, *, anyway: bool = False) -> Sequence[Item]:
        """Return the waiting messages if they may pass now, or with ``anyway``."""
        if not anyway and not self._ends(now_ns):
            self.due_ns = min(now_ns + _LOOK_NS, self._until_ns) if self._held else self._until_ns
            return ()
        self.due_ns = None
        return self._release()

    def _release(self) -> Sequence[Item]:
        self.over = True
        items = tuple(self._held)
        self._held.clear()
        return items

    def _ends(self, now_ns: int) -> bool:
        return self.over or now_ns >= self._until_ns or self._matched()


class Unsent(Stage):
    """Keeps one message that could not be sent, such as by an inactive node, for another attempt."""

    _item: Item | None = None

    def keep(self, item: Item, now_ns: int) -> None:
        """Keep a message; :meth:`take` has returned the previous one."""
        self._item, self.due_ns = item, now_ns + _RETRY_NS

    def take(self) -> Item | None:
        """Remove and return the waiting message."""
        item, self._item, self.due_ns = self._item, None, None
        return item

    def flush(self, now_ns: int, *, anyway: bool = False) -> Sequence[Item]:
        """Return the waiting message if it is due."""
        if self.due_ns is None or (now_ns < self.due_ns and not anyway):
            return ()
        item = self.take()
        return () if item is None else (item,)


class Samples(Stage):
    """From a given time on, passes on messages from ``make`` at a steady rate."""

    def __init__(self, first_ns: int, period_ns: int, make: Callable[[int], Item]) -> None:
        self.due_ns: int = first_ns
        self._period_ns, self._make = period_ns, make

    def flush(self, now_ns: int, *, anyway: bool = False) -> Sequence[Item]:
        """Return a message if one is due."""
        if now_ns < self.due_ns:
            return ()
        # A bridge that was stopped owes no messages.
        self.due_ns = max(self.due_ns + self._period_ns, now_ns)
        return (self._make(now_ns),)


class Substitute(Stage):
    """Publishes a configured message at a steady rate while the PLC is silent."""

    clears = True

    def __init__(
        self,
        silence: Silence,
        period_ns: int,
        publish: Callable[[int], None],
        changed: Callable[[bool], None],
    ) -> None:
        self.active = False
        self._silence = silence
        self._period_ns = period_ns
        # ``changed`` is called when substitutes begin (True) or end, before the first of the others is sent.
        self._publish, self._changed = publish, changed
        self._next_ns = 0

    @property
    def due_ns(self) -> int:  # type: ignore[override]
        """When the next substitute is due, if the PLC stays silent."""
        return max(self._silence.due_ns, self._next_ns)

    def offer(self, item: Item, now_ns: int) -> Sequence[Item]:
        """Accept a message from the PLC: substitutes end before it is published."""
        if self.active:
            self.active = False
            self._changed(False)
        return (item,)

    def flush(self, now_ns: int, *, anyway: bool = False) -> Sequence[Item]:
        """Publish a substitute if one is due."""
        due = self.due_ns
        if now_ns < due:
            return ()
        if not self.active:
            self.active = True
            self._changed(True)
        # A bridge that was stopped owes no substitutes.
        self._next_ns = max(due + self._period_ns, now_ns)
        self._publish(now_ns)
        return ()
