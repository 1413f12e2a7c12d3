"""One topic of a running bridge: a ROS endpoint and a port, and what is between them."""

from __future__ import annotations

import threading
from abc import ABC, abstractmethod
from collections.abc import Callable
from contextlib import suppress
from typing import Any

from rosplc.bridge import hold
from rosplc.bridge.hold import Hold, Silence, Stage
from rosplc.bridge.port import QUIET_NS, Context, Counters, Port, Ports, PortStatus, log
from rosplc.bridge.status import TopicStatus
from rosplc.codec import TRUNCATED, Codec, Fault, Wire
from rosplc.config.quantities import format_duration
from rosplc.config.resolve import TopicPlan
from rosplc.config.stale_plan import flag_topic
from rosplc.errors import BackendError, ChannelError, RosplcError
from rosplc.layout import compute_layout
from rosplc.ros import Backend, EndpointStatus, Publisher, Qos, Subscription
from rosplc.shm.constants import FLAG_FIRST, STAMP_SYSTEM

__all__ = ["Stream", "ToPlc", "ToRos"]

_EXPLAINED_NS = 2_000_000_000
_NO_TIME = 2**63 - 1
"""DDS and ROS count ns since 1970 in signed 64 bits; the largest number means none."""
_BOOL = "std_msgs/msg/Bool"
_FLAG_QOS = Qos(reliability="reliable", durability="transient_local", depth=1)


class Stream(ABC):
    """One topic; :class:`rosplc.bridge.port.Side` is what its port sees of it.

    Args:
        plan: What to carry, and how.
        context: What the bridge's streams share.
        ports: The kind of port that carries it.

    Attributes:
        plan: As given.
        codec: Wire bytes to record and back.
        port: The PLC's side.
        counters: What was counted since the start.
        problem: Why it cannot be carried at present; empty if it is.
        silence: Since when its source has been silent.
        hold: What holds its messages back.
    """

    def __init__(self, plan: TopicPlan, context: Context, ports: Ports[Any]) -> None:
        self.plan = plan
        self.context = context
        self.codec = Codec(plan.layout, Wire.ROS1 if plan.layout.store.ros_version == 1 else Wire.CDR)
        self.counters = Counters()
        self.problem = ""
        self._now = context.clock.monotonic_ns
        now = self._now()
        self.silence = Silence(plan.stale_after_ns, context.debounce_ns, now)
        self.hold = Hold((), lambda *_: None)
        self._reason: tuple[str, str, int] | None = None  # words, code, when
        self._lost_before = 0
        self._rate = 0.0
        self._rate_from: tuple[int, int] = (now, 0)
        self.port: Port = ports.make(self)

    # -- life

    @abstractmethod
    def connect(self, backend: Backend) -> None:
        """Subscribe or advertise. Raises as the backend does; BackendError ROS019."""

    def _check_backend(self, backend: Backend) -> None:
        """Raise BackendError ROS019 if the backend would pass over what the topic's QoS promises."""
        if self.plan.qos.promises and "deadline" not in backend.capabilities:
            what = f"the {backend.name} backend carries neither deadline nor lease"
            raise BackendError("ROS019", what, where=self.plan.topic)

    @abstractmethod
    def disconnect(self) -> None:
        """Take the endpoint off the graph; harmless twice."""

    @abstractmethod
    def begin(self, now_ns: int) -> None:
        """The stream is connected, and about to be served."""

    def finish(self, now_ns: int) -> None:
        """Pass on what waits, though its time has not come."""
        self.hold.flush(now_ns, anyway=True)

    def flush(self, now_ns: int) -> None:
        """Pass on what waited for its time."""
        self.hold.flush(now_ns)

    # -- housekeeping, about once a second

    def check(self, now_ns: int) -> bool:
        """Look after port and rate; return whether the port must be opened again.

        Never calls the ROS side, which may hang while the beats continue.
        """
        since, count = self._rate_from
        if now_ns - since >= 500_000_000:
            self._rate = (self.counters.received - count) * 1e9 / (now_ns - since)
            self._rate_from = (now_ns, self.counters.received)
        try:
            return self.port.check(now_ns)
        except (ChannelError, ValueError, OSError) as error:
            self.fail(now_ns, error)
            return True

    def ask(self, now_ns: int) -> None:
        """Ask the ROS side: tell the PLC how many peers there are, and note new losses."""
        endpoint = self.endpoint()
        if endpoint is not None:
            self._tell(endpoint.matched)
        lost = self._lost(endpoint, self.port.status(now_ns))
        if lost > self._lost_before:
            # What lost a message a moment ago may have been noted with a better reason.
            if self._reason is None or now_ns - self._reason[2] > _EXPLAINED_NS:
                self.note(now_ns, self.port.loss(lost - self._lost_before))
            self._lost_before = lost

    def _tell(self, matched: int) -> None:
        self.port.tell(matched)

    def reopen(self, now_ns: int) -> bool:
        """Close the port and open it again; return whether that succeeded."""
        try:
            self.port.close()
            self.port.open()
        except (RosplcError, OSError, ValueError) as error:
            self.fail(now_ns, error)
            return False
        self.problem = ""
        log.info("%s: the object is available again", self.plan.topic)
        return True

    # -- what the port tells

    def receive(self, data: bytes, flags: int, stamp_ns: int, stamp_clock: int) -> None:
        """Take a message from the PLC, encoded."""
        raise NotImplementedError

    def delivered(self, data: bytes, flags: int) -> None:
        """A message has reached the PLC."""
        raise NotImplementedError

    def refuse(self, fault: Fault, now_ns: int) -> None:
        """Count and explain a message that cannot be converted."""
        self.counters.refused += 1
        explained = self.codec.explain(fault)
        self.note(now_ns, f"message refused: {explained.where}: {explained.what}", explained.code)

    def note(self, now_ns: int, words: str, code: str = "") -> None:
        """Remember and log what went wrong."""
        self._reason = (words, code, now_ns)
        suffix = f" [{code}]" if code else ""
        self.context.warnings.warn((self.plan.topic, code), now_ns, f"{self.plan.topic}: {words}{suffix}")

    def fail(self, now_ns: int, error: Exception) -> None:
        """Remember an error that keeps the stream from being carried until the port is opened again."""
        words, code = str(error) or type(error).__name__, ""
        if isinstance(error, RosplcError):
            words, code = error.what, error.code
        self.problem = f"{words} [{code}]" if code else words
        self.note(now_ns, words, code)

    def renewed(self) -> None:
        """Another object is open, or none: the PLC does not have the last message."""
        self.hold.forget()

    # -- status

    @abstractmethod
    def endpoint(self) -> EndpointStatus | None:
        """Return the state of the ROS side's endpoint, None before there is one."""

    def _lost(self, endpoint: EndpointStatus | None, port: PortStatus) -> int:
        return self.counters.lost + port.lost

    @property
    def substituting(self) -> bool:
        """Whether something else is passed on in the source's place."""
        return False

    def status(self, now_ns: int) -> TopicStatus:
        """Return the stream's present state."""
        plan, count, silence, port = self.plan, self.counters, self.silence, self.port.status(now_ns)
        endpoint = self.endpoint()
        reason, code, when = self._reason or ("", "", 0)
        recent = bool(reason) and now_ns - when < QUIET_NS
        if endpoint is not None and endpoint.code and not recent:
            reason, code, recent = endpoint.reason, endpoint.code, True
        return TopicStatus(
            topic=plan.topic,
            type_name=plan.type_name,
            direction=plan.direction,
            matched=endpoint.matched if endpoint else 0,
            received=count.received,
            published=count.published,
            skipped=self.hold.skipped + port.skipped,
            lost=self._lost(endpoint, port),
            refused=count.refused + (endpoint.rejected if endpoint else 0),
            truncated=count.truncated,
            deadlines_missed=endpoint.late if endpoint else 0,
            rate_hz=self._rate,
            age_ns=silence.age_ns(now_ns),
            stale=silence.stale(now_ns),
            silent=silence.reported(now_ns),
            substituting=self.substituting,
            substituted=count.substituted,
            recovered=count.recovered,
            peer_alive=port.peer_alive,
            peer_gone_ns=None if port.peer_gone_ns is None else max(0, now_ns - port.peer_gone_ns),
            tasks=port.tasks,
            problem=self.problem,
            reason=reason,
            code=code,
            recent=recent,
            classic=port.classic,
        )


class ToPlc(Stream):
    """One topic towards the PLC: the backend's thread gives each message to the port.

    Args:
        plan: As for :class:`Stream`.
        context: As for :class:`Stream`.
        ports: As for :class:`Stream`.
        on_due: Called, from any thread, when a message waits for its time; :meth:`flush` sends it.
    """

    def __init__(
        self, plan: TopicPlan, context: Context, ports: Ports[Any], on_due: Callable[[], None]
    ) -> None:
        super().__init__(plan, context, ports)
        self._subscription: Subscription | None = None
        self._on_due = on_due
        self._first = True
        self._lock = threading.Lock()  # the hold has two users: callback and flush
        stages: list[Stage] = []
        if plan.on_change:
            stages.append(hold.OnChange(self._record))
        if plan.min_interval_ns:
            stages.append(hold.RateLimiter(plan.min_interval_ns))
        self.hold = Hold(stages, self._put)

    def connect(self, backend: Backend) -> None:
        """Subscribe."""
        self._check_backend(backend)
        plan = self.plan
        self._subscription = backend.subscribe(plan.topic, plan.type_name, plan.qos, self.on_message)

    def disconnect(self) -> None:
        """End the subscription."""
        if self._subscription is not None:
            self._subscription.close()

    def begin(self, now_ns: int) -> None:
        """The next message is marked as the first."""
        self._first = True

    def on_message(self, data: bytes, stamp_ns: int) -> None:
        """Take a message from the backend."""
        now = self._now()
        self.counters.received += 1
        if self.silence.heard(now):
            self.counters.recovered += 1
            self._first = True
        if not self.hold.stages:
            self.port.put(data, stamp_ns, FLAG_FIRST if self._first else 0, now)
            return
        with self._lock:
            before = self.hold.due_ns
            self.hold.offer((data, stamp_ns), now)
            waits = before is None and self.hold.due_ns is not None
        if waits:
            self._on_due()

    def _put(self, data: bytes, stamp_ns: int, now_ns: int) -> None:
        self.port.put(data, stamp_ns, FLAG_FIRST if self._first else 0, now_ns)

    def _record(self, data: bytes) -> bytes | None:
        """Return a message as the PLC has it: different bytes on the wire may be the same message."""
        with suppress(Fault):  # the port finds out again, and explains
            return self.codec.plan.decode(data, self.plan.truncate)[0]
        return None

    def flush(self, now_ns: int) -> None:
        """Pass on what waited for its time."""
        with self._lock:
            super().flush(now_ns)

    def finish(self, now_ns: int) -> None:
        """Pass on what waits."""
        with self._lock:
            super().finish(now_ns)

    def delivered(self, data: bytes, flags: int) -> None:
        """A message has reached the PLC."""
        self._first = False
        self.counters.published += 1
        if flags & TRUNCATED:
            self.counters.truncated += 1
        if self.plan.print:
            record = self.codec.decode(data, truncate=self.plan.truncate)
            log.info("%s: to the PLC: %s", self.plan.topic, self.plan.layout.to_dict(record))

    def renewed(self) -> None:
        """Another object is open: the next message is marked as the first."""
        super().renewed()
        self._first = True

    def _tell(self, matched: int) -> None:
        if not matched:
            self._first = True  # the next publisher is another source, or the same one back again
        super()._tell(matched)

    def endpoint(self) -> EndpointStatus | None:
        """Return the state of the subscription."""
        return None if self._subscription is None else self._subscription.status()

    def _lost(self, endpoint: EndpointStatus | None, port: PortStatus) -> int:
        return super()._lost(endpoint, port) + (endpoint.dropped if endpoint else 0)


class ToRos(Stream):
    """One topic towards ROS; its methods are called by the carrier's thread unless they say otherwise."""

    def __init__(self, plan: TopicPlan, context: Context, ports: Ports[Any]) -> None:
        super().__init__(plan, context, ports)
        self._time = context.clock.time_ns
        self._publisher: Publisher | None = None
        self._substitute: hold.Substitute | None = None
        self._flag: Publisher | None = None
        self._substituted_before = 0
        self._unsent = hold.Unsent() if plan.latched else None
        self._retained: bytes | None = None  # the message from before the start, which is in no counter
        stages: list[Stage] = []
        if plan.on_change:
            stages.append(hold.OnChange())  # the encoder leaves nothing of unused bytes
        if plan.min_interval_ns:
            stages.append(hold.RateLimiter(plan.min_interval_ns))
        if self._unsent is not None:
            stages.append(self._unsent)
        if plan.on_stale.action == "substitute":
            stale = plan.on_stale
            self._payload = self.codec.encode(stale.record)
            self._substitute = hold.Substitute(
                self.silence, stale.period_ns, self._send_substitute, self._substitutes
            )
            layout = compute_layout(plan.layout.store, _BOOL)
            flag = Codec(layout, self.codec.wire)
            self._flags = {state: flag.encode(layout.pack({"data": state})) for state in (False, True)}
            stages.append(self._substitute)
        self.hold = Hold(stages, self._send)

    def connect(self, backend: Backend) -> None:
        """Advertise."""
        self._check_backend(backend)
        plan = self.plan
        self._publisher = backend.advertise(plan.topic, plan.type_name, plan.qos)
        if self._substitute is not None:
            # A ROS message has no room for a flag: another topic tells whether substitutes are published.
            self._flag = backend.advertise(flag_topic(plan.topic), _BOOL, _FLAG_QOS)
            self._show(False)

    def disconnect(self) -> None:
        """Withdraw the publisher."""
        if self._publisher is not None:
            self._publisher.close()
        flag, self._flag = self._flag, None
        if flag is not None:
            flag.close()

    def begin(self, now_ns: int) -> None:
        """Let the first messages wait for a subscriber; publish what is retained for later ones."""
        publisher = self._publisher
        if publisher is None:
            return
        if self.plan.latched and (found := self.port.retained()) is not None:
            self._retained = found[0]
            self._send(found[0], self._stamp(*found[1:]), now_ns)
        grace = hold.Grace(
            now_ns + hold.GRACE_NS,
            self.plan.qos.depth if self.plan.every else 1,
            lambda: publisher.matched > 0,
        )
        last = (self._unsent is not None) + (self._substitute is not None)  # which come after it
        self.hold.stages.insert(len(self.hold.stages) - last, grace)

    def _stamp(self, stamp_ns: int, stamp_clock: int) -> int:
        # A stamp of the PLC's own clock means nothing in ROS; the bridge stamps on arrival.
        return stamp_ns if stamp_clock == STAMP_SYSTEM and 0 < stamp_ns < _NO_TIME else self._time()

    def receive(self, data: bytes, flags: int, stamp_ns: int, stamp_clock: int) -> None:
        """Pass on a message that was taken."""
        now = self._now()
        count = self.counters
        count.received += 1
        if self.silence.heard(now):
            count.recovered += 1
        if flags & TRUNCATED:
            count.truncated += 1
        stamp = self._stamp(stamp_ns, stamp_clock)
        if self.hold.stages:
            self.hold.offer((data, stamp), now)
        else:
            self._send(data, stamp, now)

    def _send(self, data: bytes, stamp_ns: int, now_ns: int) -> None:
        count, counted = self.counters, data is not self._retained
        if not self.port.owned():
            # Resumed after a stop: what was taken before is older than what the other bridge has sent.
            count.lost += counted
            if not self.problem:
                self.fail(now_ns, ChannelError("SHM116", "another bridge has taken the topic over"))
            return
        self._give_up_unsent()
        if (failure := self._write(data, stamp_ns)) is not None:
            if self._unsent is not None and failure[1] == "ROS009":
                self._unsent.keep((data, stamp_ns), now_ns)
                self.note(now_ns, f"the newest message waits: {failure[0]}", failure[1])
                return
            count.lost += counted
            self.hold.forget()
            self.note(now_ns, f"message not sent: {failure[0]}", failure[1])
            return
        count.published += counted
        if self.plan.print:
            record = self.codec.decode(data)
            log.info("%s: from the PLC: %s", self.plan.topic, self.plan.layout.to_dict(record))

    def _write(self, data: bytes, stamp_ns: int) -> tuple[str, str] | None:
        """Publish; return why that failed, as words and an error's code, else None."""
        if self._publisher is None:
            return "there is no publisher", ""
        try:
            sent = self._publisher.write(data, stamp_ns)
        except RosplcError as error:
            return error.what, error.code
        except Exception as error:  # a backend's own mistake must not stop the other streams
            return f"{type(error).__name__}: {error}", ""
        return None if sent else ("a subscriber does not keep up", "")

    def _give_up_unsent(self) -> None:
        """Count the message that waits for an active node as lost: something newer takes its place."""
        if self._unsent is not None and (item := self._unsent.take()) is not None:
            self.counters.lost += item[0] is not self._retained

    def finish(self, now_ns: int) -> None:
        """Pass on what waits."""
        super().finish(now_ns)
        self._give_up_unsent()

    def flush(self, now_ns: int) -> None:
        """Pass on what waited for its time; no substitute while another bridge carries the topic."""
        if (substitute := self._substitute) is not None and self._taken_over():
            self.silence.excuse(now_ns)
            if substitute.active:
                substitute.active = False
                self._show(False)
        super().flush(now_ns)

    def _taken_over(self) -> bool:
        return "[SHM116]" in self.problem if self.problem else not self.port.owned()

    def _send_substitute(self, now_ns: int) -> None:
        """Publish what takes the PLC's place; it is counted apart, and its loss is no message's."""
        self.hold.forget()
        self._give_up_unsent()
        if (failure := self._write(self._payload, self._time())) is None:
            self.counters.substituted += 1
        else:
            self.note(now_ns, f"substitute not sent: {failure[0]}", failure[1])

    def _substitutes(self, active: bool) -> None:
        topic, count = self.plan.topic, self.counters
        if active:
            self._substituted_before = count.substituted
            every = format_duration(self.plan.on_stale.period_ns)
            log.warning("%s: the PLC is silent; a substitute is published every %s", topic, every)
        else:
            number = count.substituted - self._substituted_before
            log.info("%s: the PLC sends again, after %d substitutes", topic, number)
        self._show(active)

    def _show(self, active: bool) -> None:
        if self._flag is not None:
            with suppress(RosplcError):  # the topic's own messages meet the same trouble, and it is noted
                self._flag.write(self._flags[active])

    @property
    def substituting(self) -> bool:
        """Whether substitutes are published now."""
        return self._substitute is not None and self._substitute.active

    def endpoint(self) -> EndpointStatus | None:
        """Return the state of the publisher."""
        return None if self._publisher is None else self._publisher.status()
