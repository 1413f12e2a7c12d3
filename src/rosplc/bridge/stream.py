"""One topic of a running bridge: a ROS endpoint, a port, and the path between them."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from contextlib import suppress
from typing import Any

from rosplc.bridge import hold
from rosplc.bridge.hold import Hold, Silence, Stage
from rosplc.bridge.port import Context, Counters, Notes, Port, Ports, log
from rosplc.bridge.status import TopicStatus
from rosplc.codec import TRUNCATED, Codec, Fault
from rosplc.config.plans import flag_topic
from rosplc.config.quantities import format_duration
from rosplc.config.resolve import TopicPlan
from rosplc.errors import BackendError, ChannelError, RosplcError
from rosplc.layout import compute_layout
from rosplc.ros import Backend, EndpointStatus, OnMessage, Publisher, Qos
from rosplc.shm import Direction
from rosplc.shm.constants import FLAG_FIRST, STAMP_SYSTEM

_EXPLAINED_NS = 2_000_000_000
_NO_TIME = 2**63 - 1  # DDS and ROS count ns since 1970 in signed 64 bits; the largest number means none
_BOOL = "std_msgs/msg/Bool"
_FLAG_QOS = Qos(reliability="reliable", durability="transient_local", depth=1)


class Stream(Notes, ABC):
    """One topic: its ROS endpoint, its port, and the path between them; both report events to it."""

    substituting = False  # whether something else is passed on in the source's place
    _unsent: hold.Unsent | None = None
    _known: tuple[tuple[Any, ...], TopicStatus | None] = ((), None)  # what the last status was made of
    _looked_ns = 0

    def __init__(self, plan: TopicPlan, context: Context, ports: Ports[Any]) -> None:
        super().__init__(plan, context)
        self.plan = plan
        self.codec = Codec(plan.layout)
        self.counters = Counters()
        self._sink: Any = None  # what passes messages on without this
        self._now = context.clock.monotonic_ns
        now = self._now()
        # since when its source has been silent
        self.silence = Silence(plan.stale_after_ns, context.debounce_ns, now)
        self._lost_before = 0
        self._rate = 0.0
        self._rate_from: tuple[int, int] = (now, 0)
        stages: list[Stage] = []
        if plan.on_change:
            stages.append(hold.OnChange(self._key))
        if plan.min_interval_ns:
            stages.append(hold.RateLimiter(plan.min_interval_ns))
        self.hold = Hold(stages, self._send)
        self.port: Port = ports.make(self)

    @abstractmethod
    def _key(self, data: bytes) -> bytes | None:
        """Return the key that distinguishes messages with ``on_change``; None if there is none."""

    @abstractmethod
    def _send(self, data: bytes, stamp_ns: int, now_ns: int) -> None:
        """Send a message that has passed all stages."""

    # -- life

    def connect(self, backend: Backend) -> None:
        """Subscribe or advertise. Raises as the backend does; BackendError ROS019."""
        if self.plan.qos.promises and "deadline" not in backend.capabilities:
            what = f"the {backend.name} backend supports neither deadline nor lease"
            raise BackendError("ROS019", what, where=self.plan.topic)
        self._connect(backend)

    @abstractmethod
    def _connect(self, backend: Backend) -> None:
        """As :meth:`connect`."""

    def disconnect(self) -> None:
        """Remove the endpoint from the ROS graph; a second call does nothing."""
        if self._endpoint is not None:
            self._endpoint.close()

    @abstractmethod
    def begin(self, now_ns: int) -> None:
        """Prepare for being served: the stream is connected."""

    def finish(self, now_ns: int) -> None:
        """Send all waiting messages, even if they are not due."""
        self.hold.flush(now_ns, anyway=True)

    def flush(self, now_ns: int) -> None:
        """Send the messages that are due."""
        self.hold.flush(now_ns)

    # -- housekeeping, about once a second

    def check(self, now_ns: int) -> bool:
        """Check the port and the rate; return whether the port must be opened again."""
        # Never calls the ROS side, which may hang while the beats continue.
        since, count = self._rate_from
        if now_ns - since >= 500_000_000:
            received = self.counters.received + self._passed()
            self._rate = (received - count) * 1e9 / (now_ns - since)
            self._rate_from = (now_ns, received)
            if self._rate:
                self.still = False
        try:
            return self.port.check(now_ns)
        except (ChannelError, ValueError, OSError) as error:
            self.fail(now_ns, error)
            return True

    def ask(self, now_ns: int) -> None:
        """Query the ROS side: show the PLC the number of ROS endpoints, and note new losses."""
        self.still = True  # only here, and only cleared elsewhere: what other threads see is not lost
        endpoint, status = self._look(now_ns)
        if endpoint is not None:
            self._tell(endpoint.matched)
        if (lost := status.lost) > self._lost_before:
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
        self.problem, self.still = "", False
        log.info("%s: the object is available again", self.plan.topic)
        return True

    # -- what the port tells

    def receive(self, data: bytes, flags: int, stamp_ns: int, stamp_clock: int) -> None:
        """Accept an encoded message from the PLC."""
        raise NotImplementedError

    def delivered(self, data: bytes, flags: int) -> None:
        """A message has reached the PLC."""
        raise NotImplementedError

    def _passed(self) -> int:
        """Return how many messages bypassed this object, and note the time of the last one."""
        if self._sink is None:
            return 0
        self.silence.passed(self._sink.last_ns)
        return int(self._sink.messages)

    def _open_sink(self, opens: Any) -> None:
        """Let the next messages bypass this object if nothing has to inspect each of them."""
        holds = any(one is not self._unsent or one.due_ns is not None for one in self.hold.stages)
        if self._sink is not None and not holds and not self.plan.print:
            opens.open_sink(self.plan.stale_after_ns)

    def _came(self, now_ns: int) -> bool:
        """Count a message; return whether its source was stale before it."""
        self._passed()
        self.counters.received += 1
        recovered = self.silence.heard(now_ns)
        self.counters.recovered += recovered
        return recovered

    def _print(self, way: str, data: bytes) -> None:
        if self.plan.print:
            record = self.codec.decode(data, truncate=self.plan.truncate)
            log.info("%s: %s the PLC: %s", self.plan.topic, way, self.plan.layout.to_dict(record))

    def refuse(self, fault: Fault, now_ns: int) -> None:
        """Count and explain a message that cannot be converted."""
        self.counters.refused += 1
        explained = self.codec.explain(fault)
        self.note(now_ns, f"message refused: {explained.where}: {explained.what}", explained.code)

    def renewed(self) -> None:
        """Note that another object is open, or none: the PLC does not have the last message."""
        self.hold.forget()

    # -- status

    def endpoint(self) -> EndpointStatus | None:
        """Return the state of the ROS endpoint; None before it exists."""
        return None if self._endpoint is None else self._endpoint.status()

    def status(self, now_ns: int, within_ns: int = 0) -> TopicStatus:
        """Return the stream's state, at most ``within_ns`` old if it changes; without an age one object."""
        _, status = self._known
        if status is None or not within_ns or (now_ns - self._looked_ns >= within_ns and not self.still):
            _, status = self._look(now_ns)
        if (age_ns := self.silence.age_ns(now_ns)) is None:
            return status
        aged = object.__new__(TopicStatus)  # many each second: the constructor takes ten times as long
        vars(aged).update(vars(status), age_ns=age_ns)
        return aged

    def _look(self, now_ns: int) -> tuple[EndpointStatus | None, TopicStatus]:
        """Return the state of the endpoint, and that of the stream without its age."""
        passed, truncated, counters = self._passed(), getattr(self._sink, "truncated", 0), vars(self.counters)
        plan, silence, endpoint, port = self.plan, self.silence, self.endpoint(), self.port.status(now_ns)
        rate, stale, silent = self._rate, silence.stale(now_ns), silence.reported(now_ns)
        skipped, substituting, noted = self.hold.skipped, self.substituting, self.noted(now_ns, endpoint)
        states = rate, stale, silent, substituting, silence.last_ns is None
        basis = endpoint, port, *states, *noted.values(), passed, truncated, skipped, *counters.values()
        (before, status), self._looked_ns = self._known, now_ns
        waits = rate or noted["recent"] or not stale == silent == bool(plan.stale_after_ns)
        if basis != before or waits or plan.own or plan.port != "channel" or self.hold.due_ns is not None:
            self.still = False
        if basis == before and status is not None:
            return endpoint, status
        found = vars(port) | counters | noted | {"lost": self.counters.lost + port.lost}
        for name, more in (("received", passed), ("published", passed), ("truncated", truncated)):
            found[name] += more
        found["skipped"] += skipped
        if endpoint is not None:
            found["refused"] += endpoint.rejected
            found |= {"matched": endpoint.matched, "deadlines_missed": endpoint.late}
            if plan.direction is Direction.TO_PLC:  # what a publisher drops was noticed when it was given it
                found["lost"] += endpoint.dropped
        found |= {"topic": plan.topic, "type_name": plan.type_name, "direction": plan.direction}
        found |= {"rate_hz": rate, "stale": stale, "silent": silent, "substituting": substituting}
        vars(status := object.__new__(TopicStatus)).update(found)  # as in status()
        self._known = basis, status
        return endpoint, status


class ToPlc(Stream):
    """One topic to the PLC: the backend's thread gives each message to the port.

    ``on_due`` is called from any thread when a message has to wait; :meth:`flush` sends it.
    """

    def __init__(
        self, plan: TopicPlan, context: Context, ports: Ports[Any], on_due: Callable[[], None]
    ) -> None:
        super().__init__(plan, context, ports)
        self._on_due = on_due
        self._first = True

    def _connect(self, backend: Backend) -> None:
        plan = self.plan
        self._endpoint = backend.subscribe(plan.topic, plan.type_name, plan.qos, self.on_message)
        divert, sink = getattr(self._endpoint, "divert", None), self.port.sink
        self._sink = sink if divert is not None and sink is not None and divert(sink) else None

    def begin(self, now_ns: int) -> None:
        """Mark the next message as the first."""
        self._first = True

    def on_message(self, data: bytes, stamp_ns: int) -> None:
        """Accept a message from the backend."""
        now = self._now()
        if self._came(now):
            self._first = True
        if not self.hold.stages:
            self._send(data, stamp_ns, now)
        elif self.hold.offer((data, stamp_ns), now):
            self._on_due()
        if self._sink is not None and not self._first:
            self._open_sink(self.port)
            if self._first:  # from another thread meanwhile
                self._sink.close()

    def _send(self, data: bytes, stamp_ns: int, now_ns: int) -> None:
        self.port.put(data, stamp_ns, FLAG_FIRST if self._first else 0, now_ns)

    def _key(self, data: bytes) -> bytes | None:
        # As the PLC has it: different bytes on the wire may be the same message.
        with suppress(Fault):  # the port finds out again, and explains
            return self.codec.plan.decode(data, self.plan.truncate)[0]
        return None

    def delivered(self, data: bytes, flags: int) -> None:
        """A message has reached the PLC."""
        self._first = False
        self.counters.published += 1
        if flags & TRUNCATED:
            self.counters.truncated += 1
        self._print("to", data)

    def renewed(self) -> None:
        """Note that another object is open: the next message is marked as the first."""
        super().renewed()
        self._first = True

    def _tell(self, matched: int) -> None:
        if not matched:
            self._first = True  # the next publisher is another source, or the same one back again
            if self._sink is not None:
                self._sink.close()
        super()._tell(matched)


class ToRos(Stream):
    """One topic to ROS; the carrier's thread calls its methods unless stated otherwise."""

    def __init__(self, plan: TopicPlan, context: Context, ports: Ports[Any]) -> None:
        super().__init__(plan, context, ports)
        self._time = context.clock.time_ns
        self._backend: Backend | None = None
        self._publisher: Publisher | None = None
        self._substitute: hold.Substitute | None = None
        self._flag: Publisher | None = None
        self._substituted_before = 0
        self._unsent = hold.Unsent() if plan.latched else None
        self._retained: bytes | None = None  # the message from before the start, which is in no counter
        if self._unsent is not None:
            self.hold.stages.append(self._unsent)
        if plan.on_stale.action == "substitute":
            stale = plan.on_stale
            self._payload = self.codec.encode(stale.record)
            send, changed = self._send_substitute, self._substitutes
            self._substitute = hold.Substitute(self.silence, stale.period_ns, send, changed)
            layout = compute_layout(plan.layout.store, _BOOL)
            flag = Codec(layout)
            self._flags = {state: flag.encode(layout.pack({"data": state})) for state in (False, True)}
            self.hold.stages.append(self._substitute)

    def _key(self, data: bytes) -> bytes:
        return data  # the encoder leaves nothing of unused bytes

    def _connect(self, backend: Backend) -> None:
        plan = self.plan
        self._backend = backend
        passed = self._passed()  # with the publisher before
        self.counters.received += passed
        self.counters.published += passed
        self._endpoint = self._publisher = backend.advertise(plan.topic, plan.type_name, plan.qos)
        self._sink = self.port.sink = getattr(self._publisher, "sink", None)
        if self._substitute is not None:
            # A ROS message has no room for a flag: another topic tells whether substitutes are published.
            self._flag = backend.advertise(flag_topic(plan.topic), _BOOL, _FLAG_QOS)
            self._show(False)

    def disconnect(self) -> None:
        """Withdraw the publisher."""
        super().disconnect()
        flag, self._flag = self._flag, None
        if flag is not None:
            flag.close()

    def fail(self, now_ns: int, error: Exception) -> None:
        """Note an error; while another bridge carries the topic, withdraw the retained message."""
        # DDS sends that to subscribers that it discovers, again where this bridge was stopped for longer than
        # the lease: behind what the other bridge has sent.
        super().fail(now_ns, error)
        if isinstance(error, RosplcError) and error.code == "SHM116":
            self.disconnect()
            self._publisher = self._endpoint = None

    def reopen(self, now_ns: int) -> bool:
        """Open the port again, and advertise the topic again if it was withdrawn."""
        if not super().reopen(now_ns):
            return False
        if self._publisher is None and self._backend is not None:
            try:
                self._connect(self._backend)
            except RosplcError as error:
                self.fail(now_ns, error)
                return False
        return True

    def begin(self, now_ns: int) -> None:
        """Let the first messages wait for a subscriber; publish a retained message for late subscribers."""
        publisher = self._publisher
        if publisher is None:
            return
        if self.plan.latched and (found := self.port.retained()) is not None:
            self._retained = found[0]
            self._send(found[0], self._stamp(*found[1:]), now_ns)
        most = self.plan.qos.depth if self.plan.every else 1
        grace = hold.Grace(now_ns + hold.GRACE_NS, most, lambda: publisher.matched > 0)
        last = (self._unsent is not None) + (self._substitute is not None)  # which come after it
        self.hold.stages.insert(len(self.hold.stages) - last, grace)

    def _stamp(self, stamp_ns: int, stamp_clock: int) -> int:
        # A stamp of the PLC's own clock means nothing in ROS; the bridge stamps on arrival.
        return stamp_ns if stamp_clock == STAMP_SYSTEM and 0 < stamp_ns < _NO_TIME else self._time()

    def receive(self, data: bytes, flags: int, stamp_ns: int, stamp_clock: int) -> None:
        """Forward a message taken from the PLC."""
        now = self._now()
        self._came(now)
        if flags & TRUNCATED:
            self.counters.truncated += 1
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
                self.fail(now_ns, ChannelError("SHM116", "another bridge has taken over the topic"))
            return
        self._give_up_unsent()
        if (failure := self._write(data, stamp_ns)) is None:
            count.published += counted
            self._print("from", data)
            if counted:
                self._open_sink(self._publisher)
        elif self._unsent is not None and failure[1] == "ROS009":
            self._unsent.keep((data, stamp_ns), now_ns)
            self.note(now_ns, f"the newest message has not been sent yet: {failure[0]}", failure[1])
        else:
            count.lost += counted
            self.hold.forget()
            self.note(now_ns, f"message not sent: {failure[0]}", failure[1])

    def _write(self, data: bytes, stamp_ns: int) -> tuple[str, str] | None:
        """Publish; return None, or the reason for the failure: a text and an error code."""
        if self._publisher is None:
            return "the publisher is not open", ""
        try:
            sent = self._publisher.write(data, stamp_ns)
        except RosplcError as error:
            return error.what, error.code
        except Exception as error:  # a backend's own mistake must not stop the other streams
            return f"{type(error).__name__}: {error}", ""
        return None if sent else ("a subscriber cannot keep up", "")

    def _give_up_unsent(self) -> None:
        """Count the message that waits for an active node as lost: a newer one replaces it."""
        if self._unsent is not None and (item := self._unsent.take()) is not None:
            self.counters.lost += item[0] is not self._retained

    def finish(self, now_ns: int) -> None:
        """Send all waiting messages."""
        super().finish(now_ns)
        self._give_up_unsent()

    def flush(self, now_ns: int) -> None:
        """Send the messages that are due, but no substitute while another bridge carries the topic."""
        substitute, problem = self._substitute, self.problem
        if substitute is not None and ("[SHM116]" in problem if problem else not self.port.owned()):
            self.silence.excuse(now_ns)
            if substitute.active:
                substitute.active = False
                self._show(False)
        super().flush(now_ns)

    def _send_substitute(self, now_ns: int) -> None:
        """Publish a substitute for the PLC's message; it is counted separately, and never as lost."""
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
            log.info("%s: the PLC has resumed sending after %d substitutes", topic, number)
        self._show(active)

    def _show(self, active: bool) -> None:
        self.substituting = active
        if self._flag is not None:
            with suppress(RosplcError):  # the topic's own messages meet the same trouble, and it is noted
                self._flag.write(self._flags[active])


class OwnEnd:
    """The bridge's end of topics between the bridge itself and the PLC: the ROS side of their streams.

    A class that accepts messages from the PLC has a method ``write``, as a publisher does.
    """

    matched = 1

    def __init__(self) -> None:
        self.give: OnMessage = _dropped  # gives the PLC a message

    def subscribe(self, _topic: str, _type: str, _qos: Qos, on_message: OnMessage) -> OwnEnd:
        """Store the function that passes a message to the PLC."""
        self.give = on_message
        return self

    def advertise(self, *_: object) -> OwnEnd:
        """Return the object that accepts the PLC's messages."""
        return self

    def status(self) -> EndpointStatus:
        """Return a status that shows ``matched``."""
        return EndpointStatus("", "", "in", self.matched)

    def close(self) -> None:
        """Stop passing messages to the PLC."""
        self.give = _dropped


def _dropped(_data: bytes, _stamp_ns: int) -> None:
    return
