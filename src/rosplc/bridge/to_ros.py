"""PLC → ROS: one thread takes what is new from all channels in one call, and publishes it."""

from __future__ import annotations

import threading
import time
from collections import deque
from collections.abc import Callable, Collection
from contextlib import suppress

from rosplc._core._native import Fault, Group
from rosplc.bridge.gate import Gate
from rosplc.bridge.grace import GRACE_NS, Grace
from rosplc.bridge.order import Order
from rosplc.bridge.substitute import Substitute
from rosplc.bridge.topic import Surroundings, Topic, log
from rosplc.codec import TRUNCATED
from rosplc.config.resolve import TopicPlan
from rosplc.errors import ChannelError, RosplcError
from rosplc.ros import Backend, EndpointStatus, Publisher
from rosplc.shm import OwnedChannel, Reader, Region
from rosplc.shm.constants import STAMP_SYSTEM, WRITER_LINE

__all__ = ["Pump", "ToRos"]

_IN_ORDER = 1
_LONGEST_WAIT_NS = 200_000_000
_LAZY_TICK_NS = 10_000_000
"""The tick while no PLC writes anything: the wake-ups are what an idle bridge costs."""
_NO_TIME = 2**63 - 1
"""DDS and ROS count ns since 1970 in signed 64 bits; the largest number means none."""
_ALERT_NS = 10_000_000_000
"""How long after a message the configured tick holds, whether a writer beats or not."""


class ToRos(Topic):
    """One topic towards ROS; its methods are called by the pump's thread unless they say otherwise."""

    def __init__(self, plan: TopicPlan, around: Surroundings) -> None:
        super().__init__(plan, around)
        self.reader: Reader | None = None
        self._publisher: Publisher | None = None
        self._gate: Gate[tuple[bytes, int]] | None = (
            Gate(plan.min_interval_ns) if plan.min_interval_ns else None
        )
        self._substitute = (
            Substitute(plan, self.codec, self._started_ns) if plan.on_stale.action == "substitute" else None
        )
        self._grace: Grace[tuple[bytes, int]] | None = None
        self._outwaited = 0  # messages that a newer one replaced before any subscriber was there
        self._last_data: bytes | None = None
        self._reader_lost = 0  # of readers that are no more

    def join(self, backend: Backend) -> None:
        """Advertise."""
        self._check_backend(backend)
        plan = self.plan
        self._publisher = backend.advertise(plan.topic, plan.type_name, plan.qos)
        if self._substitute is not None:
            self._substitute.join(backend)

    def leave(self) -> None:
        """Withdraw the publisher."""
        if self._publisher is not None:
            self._publisher.close()
        if self._substitute is not None:
            self._substitute.leave()

    def _claim(self, channel: OwnedChannel) -> None:
        self.reader = channel.reader(self.around.beat_ms)

    def _unclaim(self) -> None:
        reader, self.reader = self.reader, None
        if reader is not None:
            self._reader_lost += reader.lost

    def beat(self) -> None:
        """Show that this side lives; from any thread."""
        if (reader := self.reader) is not None:
            with suppress(ValueError):  # closed at this moment: the pump opens it again
                reader.beat()

    def on_message(self, data: bytes, flags: int, stamp_ns: int, stamp_clock: int) -> None:
        """Pass on a message that was taken."""
        now = time.monotonic_ns()
        count = self.counters
        count.received += 1
        self._hear(now)
        if self._substitute is not None:
            self._substitute.heard(now)
        if flags & TRUNCATED:
            count.truncated += 1
        if self.plan.on_change:
            # The encoder leaves nothing of unused bytes, so equal bytes are equal messages.
            if data == self._last_data:
                count.unchanged += 1
                return
            self._last_data = data
        # A stamp of the PLC's own clock means nothing in ROS; the bridge stamps on arrival.
        usable = stamp_clock == STAMP_SYSTEM and 0 < stamp_ns < _NO_TIME
        stamp = stamp_ns if usable else time.time_ns()
        if self._gate is None or self._gate.offer((data, stamp), now) is not None:
            self._write(data, stamp, now)

    @property
    def due_ns(self) -> int | None:
        """When a message that waits may go."""
        gate = self._gate.due_ns if self._gate is not None else None
        grace = self._grace.due_ns if self._grace is not None else None
        substitute = self._substitute.due_ns if self._substitute is not None else None
        return min((due for due in (gate, grace, substitute) if due is not None), default=None)

    def flush(self, now_ns: int) -> None:
        """Publish what waits, if its time has come."""
        if self._grace is not None:
            self._release(now_ns)
        if self._gate is not None and (item := self._gate.flush(now_ns)) is not None:
            self._write(*item, now_ns)
        if self._substitute is not None and (payload := self._substitute.take(now_ns)) is not None:
            self._release(now_ns, anyway=True)  # what the PLC said comes before what stands in for it
            self._send_substitute(payload, now_ns)

    def await_subscriber(self, now_ns: int) -> None:
        """Let the first messages wait for a subscriber, for a moment; :meth:`flush` sends them."""
        publisher = self._publisher
        if publisher is not None:
            most = self.plan.qos.depth if self.plan.every else 1
            self._grace = Grace(now_ns + GRACE_NS, most, lambda: publisher.matched > 0)

    def _release(self, now_ns: int, *, anyway: bool = False) -> None:
        grace = self._grace
        if grace is not None:
            for item in grace.release(now_ns, anyway=anyway):
                self._send(*item, now_ns)
            if grace.over:
                self._outwaited += grace.replaced
                self._grace = None

    def finish(self, now_ns: int) -> None:
        """Publish what waits for a subscriber or for its time, though neither has come."""
        self._release(now_ns, anyway=True)
        if self._gate is not None and (due := self._gate.due_ns) is not None:
            item = self._gate.flush(due)
            if item is not None:
                self._send(*item, now_ns)

    def on_fault(self, error: Fault | ChannelError, now_ns: int) -> bool:
        """Note what went wrong; return whether the object must be opened again."""
        if isinstance(error, Fault):
            self.counters.received += 1
            self.counters.refused += 1
            explained = self.codec.explain(error)
            self.note(now_ns, f"message refused: {explained.where}: {explained.what}", explained.code)
            return False
        self.fail(now_ns, error)
        return True

    def _write(self, data: bytes, stamp_ns: int, now_ns: int) -> None:
        if self._grace is not None:
            if self._grace.offer((data, stamp_ns), now_ns):
                return
            self._release(now_ns, anyway=True)
        self._send(data, stamp_ns, now_ns)

    def _send_substitute(self, payload: bytes, now_ns: int) -> None:
        """Publish what stands in for the PLC; it is counted apart, and its loss is no message's."""
        self._last_data = None  # whatever the PLC says next is news to ROS
        if (failure := self._put(payload, time.time_ns())) is None:
            self.counters.substituted += 1
            if self._substitute is not None:
                self._substitute.count += 1
        else:
            self.note(now_ns, f"substitute not sent: {failure[0]}", failure[1])

    def _send(self, data: bytes, stamp_ns: int, now_ns: int) -> None:
        if self._publisher is None:
            self.counters.lost += 1
            return
        if (failure := self._put(data, stamp_ns)) is not None:
            self._not_sent(now_ns, *failure)
            return
        self.counters.published += 1
        if self.plan.print:
            record = self.codec.decode(data)
            log.info("%s: from the PLC: %s", self.plan.topic, self.plan.layout.to_dict(record))

    def _put(self, data: bytes, stamp_ns: int) -> tuple[str, str] | None:
        """Publish; return why that failed, in words and with an error's code, else None."""
        if self._publisher is None:
            return "there is no publisher", ""
        try:
            sent = self._publisher.write(data, stamp_ns)
        except RosplcError as error:
            return error.what, error.code
        except Exception as error:  # a backend's own mistake must not stop the other topics
            return f"{type(error).__name__}: {error}", ""
        return None if sent else ("a subscriber does not keep up", "")

    def _not_sent(self, now_ns: int, why: str, code: str = "") -> None:
        self.counters.lost += 1
        self._last_data = None  # the same message again is news to ROS
        self.note(now_ns, f"message not sent: {why}", code)

    def _observe(self, region: Region, now_ns: int) -> None:
        head, epoch, beat, beat_ms = region.words(WRITER_LINE["head"], 4)
        alive = self._lives(0, beat, beat_ms, head, now_ns)
        self._watch_peer(bool(epoch) and alive, now_ns)

    def _tell(self, matched: int) -> None:
        if (reader := self.reader) is not None:
            reader.set_sinks(matched)

    def endpoint(self) -> EndpointStatus | None:
        """Return the state of the publisher."""
        return None if self._publisher is None else self._publisher.status()

    def _lost(self, endpoint: EndpointStatus | None) -> int:
        # Taking the newest alone skips messages on purpose.
        return self.counters.lost + (self._missed() if self.plan.every else 0)

    def _loss(self, count: int) -> str:
        return f"{count} messages were lost on the way out; raise depth: (now {self.plan.slots} slots)"

    def _skipped(self) -> int:
        skipped = self.counters.unchanged + self._outwaited + (self._gate.replaced if self._gate else 0)
        return skipped + (0 if self.plan.every else self._missed())

    def _substituting(self) -> bool:
        return self._substitute is not None and self._substitute.active

    def _missed(self) -> int:
        reader = self.reader
        return self._reader_lost + (0 if reader is None else reader.lost)


class Pump:
    """The thread that carries all topics towards ROS.

    Args:
        topics: The topics; their objects are open.
        tick_ns: How often it looks.

    Attributes:
        busy_since_ns: When it began to publish what it holds; 0 while it waits for news.
        turned_ns: When it last began a round, of which there are several a second.
    """

    def __init__(self, topics: tuple[ToRos, ...], tick_ns: int) -> None:
        self.busy_since_ns = 0
        self._topics = topics
        self._tick_ns = tick_ns
        self._group = Group()
        self._by_index: dict[int, ToRos] = {}
        self._index: dict[ToRos, int] = {}
        self._jobs: deque[Callable[[], None]] = deque()
        self._stopping = False
        self.turned_ns = time.monotonic_ns()
        self._alert_until_ns = 0
        self._thread = threading.Thread(target=self._run, name="rosplc-to-ros", daemon=True)
        for topic in topics:
            self._add(topic)

    def start(self) -> None:
        """Begin; what comes first may wait a moment for a subscriber, per topic."""
        now = time.monotonic_ns()
        for topic in self._topics:
            topic.await_subscriber(now)
        self._thread.start()

    def stop(self, timeout: float = 5.0) -> bool:
        """End; return whether the thread ended in time."""
        self._stopping = True
        self._group.wake()
        if self._thread.is_alive():
            self._thread.join(timeout)
        if self._thread.is_alive():
            return False
        for topic in self._topics:
            topic.finish(time.monotonic_ns())
        return True

    def reopen(self, topic: ToRos) -> None:
        """Ask, from any thread, that a topic's object be opened again."""
        self._jobs.append(lambda: self._reopen(topic))
        self._group.wake()

    def replace(self, leaving: Collection[ToRos], coming: Collection[ToRos]) -> bool:
        """Carry other topics from now on; from any thread but its own.

        Args:
            leaving: Topics to let go of; the caller may close them afterwards.
            coming: Topics to carry as well; their objects are open.

        Returns:
            False if the thread hangs in the ROS side; nothing has changed then.
        """
        order = Order(lambda: self._replace(leaving, coming))
        self._jobs.append(order)
        self._group.wake()
        return order.wait()

    def _replace(self, leaving: Collection[ToRos], coming: Collection[ToRos]) -> None:
        for topic in leaving:
            self._drop(topic)
        self._topics = (*(topic for topic in self._topics if topic not in leaving), *coming)
        for topic in coming:
            topic.await_subscriber(time.monotonic_ns())
            self._add(topic)

    def _add(self, topic: ToRos) -> None:
        if topic.reader is not None:
            mode = _IN_ORDER if topic.plan.every else 0
            index = self._group.add_reader(topic.reader, topic.codec.plan, mode, topic.plan.slots)
            self._by_index[index] = topic
            self._index[topic] = index

    def _drop(self, topic: ToRos) -> None:
        index = self._index.pop(topic, None)
        if index is not None:
            self._group.remove(index)
            del self._by_index[index]

    def _reopen(self, topic: ToRos) -> None:
        if topic not in self._topics:
            return  # it has left meanwhile, and its name with it
        self._drop(topic)
        if topic.reopen(time.monotonic_ns()):
            self._add(topic)

    def _run(self) -> None:
        while not self._stopping:
            try:
                self._turn()
            except Exception:
                log.exception("carrying messages to ROS failed; it goes on")
                time.sleep(0.1)

    def _turn(self) -> None:
        self.turned_ns = now = time.monotonic_ns()
        self._group.wait(self._tick(now), self._patience(now))
        while self._jobs:
            self._jobs.popleft()()
        if self._stopping:
            return
        messages, faults = self._group.take()
        now = time.monotonic_ns()
        if messages:
            self._alert_until_ns = now + _ALERT_NS
        self.busy_since_ns = now
        for index, data, _sequence, flags, stamp_ns, stamp_clock in messages:
            try:
                self._by_index[index].on_message(data, flags, stamp_ns, stamp_clock)
            except Exception:  # what was taken for the other topics must still be sent
                log.exception("%s: passing on a message failed", self._by_index[index].plan.topic)
        for index, fault in faults:
            topic = self._by_index[index]
            if topic.on_fault(fault, now):
                self._jobs.append(lambda topic=topic: self._reopen(topic))  # type: ignore[misc]
        for topic in self._topics:
            if topic.due_ns is not None:
                topic.flush(time.monotonic_ns())
        self.busy_since_ns = 0

    def _tick(self, now_ns: int) -> int:
        if now_ns < self._alert_until_ns or any(topic.peer_alive for topic in self._topics):
            return self._tick_ns
        return max(self._tick_ns, _LAZY_TICK_NS if self._topics else _LONGEST_WAIT_NS)

    def _patience(self, now_ns: int) -> int:
        due = min((topic.due_ns for topic in self._topics if topic.due_ns is not None), default=None)
        return _LONGEST_WAIT_NS if due is None else max(0, min(_LONGEST_WAIT_NS, due - now_ns))
