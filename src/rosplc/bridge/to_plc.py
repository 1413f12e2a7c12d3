"""ROS → PLC: the backend's thread writes each message straight into a slot."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from contextlib import suppress

from rosplc._core._native import Fault
from rosplc.bridge.gate import Gate
from rosplc.bridge.topic import Surroundings, Topic, log
from rosplc.codec import TRUNCATED
from rosplc.config.resolve import TopicPlan
from rosplc.errors import ChannelError
from rosplc.ros import Backend, EndpointStatus, Subscription
from rosplc.shm import OwnedChannel, Region, Writer
from rosplc.shm.constants import FLAG_FIRST, LINE_SIZE, READER_LINES, READER_LINES_OFFSET

__all__ = ["ToPlc"]

_LINE_WORDS = LINE_SIZE // 4


class ToPlc(Topic):
    """One topic towards the PLC.

    Args:
        plan: As for :class:`Topic`.
        around: As for :class:`Topic`.
        on_due: Called, from any thread, when a message waits for its time; :meth:`flush` sends it.
    """

    def __init__(self, plan: TopicPlan, around: Surroundings, on_due: Callable[[int], None]) -> None:
        super().__init__(plan, around)
        self.writer: Writer | None = None
        self._subscription: Subscription | None = None
        self._gate: Gate[tuple[bytes, int]] | None = (
            Gate(plan.min_interval_ns) if plan.min_interval_ns else None
        )
        self._on_due = on_due
        self._lock = threading.Lock()  # the gate has two users: callback and flush
        self._first = True
        self._last_record: bytes | None = None

    def join(self, backend: Backend) -> None:
        """Subscribe."""
        self._check_backend(backend)
        plan = self.plan
        self._subscription = backend.subscribe(plan.topic, plan.type_name, plan.qos, self.on_message)

    def leave(self) -> None:
        """End the subscription."""
        if self._subscription is not None:
            self._subscription.close()

    def _claim(self, channel: OwnedChannel) -> None:
        self.writer = channel.writer(self.around.beat_ms)
        self._first = True
        self._last_record = None  # a new object has no message that could be unchanged

    def _unclaim(self) -> None:
        self.writer = None

    def beat(self) -> None:
        """Show that the writer lives; from any thread."""
        if (writer := self.writer) is not None:
            with suppress(ValueError):  # closed at this moment
                writer.beat()

    def on_message(self, data: bytes, stamp_ns: int) -> None:
        """Take a message from the backend."""
        now = time.monotonic_ns()
        self.counters.received += 1
        if self._hear(now):
            self._first = True
        if self._gate is None:
            self._publish(data, stamp_ns, now)
            return
        with self._lock:
            waited = self._gate.due_ns
            if self._gate.offer((data, stamp_ns), now) is not None:
                self._publish(data, stamp_ns, now)
            elif waited is None and self._gate.due_ns is not None:
                self._on_due(self._gate.due_ns)

    @property
    def due_ns(self) -> int | None:
        """When a message that waits may go."""
        return self._gate.due_ns if self._gate is not None else None

    def flush(self, now_ns: int) -> None:
        """Publish the message that waits, if its time has come."""
        if self._gate is None or self._gate.due_ns is None:
            return
        with self._lock:
            item = self._gate.flush(now_ns)
            if item is not None:
                self._publish(*item, now_ns)

    def _publish(self, data: bytes, stamp_ns: int, now_ns: int) -> None:
        writer = self.writer
        if writer is None:
            self.counters.lost += 1
            return
        plan = self.plan
        flags = FLAG_FIRST if self._first else 0
        clock = 1 if stamp_ns else 0
        try:
            if plan.on_change:
                record, cut = self.codec.plan.decode(data, plan.truncate)
                if record == self._last_record:
                    self.counters.unchanged += 1
                    return
                writer.publish(record, stamp_ns=stamp_ns, stamp_clock=clock, flags=flags | cut)
                self._last_record = record
            else:
                _, cut = writer.publish_wire(
                    self.codec.plan,
                    data,
                    truncate=plan.truncate,
                    stamp_ns=stamp_ns,
                    stamp_clock=clock,
                    flags=flags,
                )
        except Fault as fault:
            self._refused(writer, fault, now_ns)
            return
        except (ChannelError, ValueError) as error:
            # Retired, damaged, claimed or just closed: the next check opens the name again.
            self.counters.lost += 1
            if self.writer is writer:
                self.writer = None
                self.fail(now_ns, error)
            return
        self._first = False
        self.counters.published += 1
        if cut & TRUNCATED:
            self.counters.truncated += 1
        if plan.print:
            self._print(data)

    def _refused(self, writer: Writer, fault: Fault, now_ns: int) -> None:
        self.counters.refused += 1
        if self.plan.on_change:
            writer.refuse()
        error = self.codec.explain(fault)
        self.note(now_ns, f"message refused: {error.where}: {error.what}", error.code)

    def _print(self, data: bytes) -> None:
        record = self.codec.decode(data, truncate=self.plan.truncate)
        log.info("%s: to the PLC: %s", self.plan.topic, self.plan.layout.to_dict(record))

    def check(self, now_ns: int) -> bool:
        """Look after the object; a writer that failed means that it must be opened again."""
        return super().check(now_ns) or self.writer is None

    def _observe(self, region: Region, now_ns: int) -> None:
        words = region.words(READER_LINES_OFFSET, READER_LINES * _LINE_WORDS)
        tasks = []
        for at in range(0, len(words), _LINE_WORDS):
            claim, beat, beat_ms, taken = words[at : at + 4]
            if claim and self._lives(at, beat, beat_ms, taken, now_ns):
                name = b"".join(word.to_bytes(4, "little") for word in words[at + 12 : at + 16])
                tasks.append(name.split(b"\0")[0].decode("utf-8", "replace"))
        self._watch_peer(bool(tasks), now_ns)
        self._tasks = tuple(tasks)

    def _tell(self, matched: int) -> None:
        if not matched:
            self._first = True  # whoever publishes next is another source, or the same one come back
        if (writer := self.writer) is not None:
            writer.set_sources(matched)

    def endpoint(self) -> EndpointStatus | None:
        """Return the state of the subscription."""
        return None if self._subscription is None else self._subscription.status()

    def _lost(self, endpoint: EndpointStatus | None) -> int:
        return self.counters.lost + (endpoint.dropped if endpoint else 0)

    def _loss(self, count: int) -> str:
        return f"{count} messages were lost on the way in; raise qos: {{depth: …}} if they come in bursts"

    def _skipped(self) -> int:
        return self.counters.unchanged + (self._gate.replaced if self._gate else 0)
