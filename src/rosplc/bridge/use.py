"""One use of a service or action: its objects, its endpoint in ROS, and the counts of its calls."""

from __future__ import annotations

import logging
from abc import ABC, abstractmethod
from collections import Counter, deque
from collections.abc import Callable, Mapping
from contextlib import ExitStack, suppress
from dataclasses import replace
from typing import Any, Literal

from rosplc.bridge.hold import Hold
from rosplc.bridge.port import Context, Notes, log
from rosplc.bridge.status import ActionStatus, ServiceStatus
from rosplc.codec import Codec, Fault
from rosplc.config.plans import CallPlan
from rosplc.config.resolve import describe
from rosplc.errors import BackendError, ChannelError, RosplcError
from rosplc.reasons import Reason
from rosplc.ros import Backend, EndpointStatus
from rosplc.shm import Group, OwnedChannel, Part, Peer, Reader, SlotInfo, Writer, attach
from rosplc.shm import constants as spec
from rosplc.shm.attach import Mapped
from rosplc.shm.calls import WORDS

_REPORT_NEWS = 2
LOOK_NS = 5_000_000
"""Time between two checks of the peers while a call waits or is open."""
IDLE_NS = 100_000_000
"""Time between two checks without such a call."""
_TOO_LARGE = (4, 5, 8)
"""Codec faults: a string or sequence exceeds a limit."""

Outcome = Literal[
    "done", "succeeded", "canceled", "aborted", "not executed", "fate unknown", "unreadable", "late"
]
ENDINGS: dict[int, Outcome] = {
    spec.ANSWER_DONE: "done",
    spec.ANSWER_NOT_EXECUTED: "not executed",
    spec.ANSWER_FATE_UNKNOWN: "fate unknown",
    spec.ANSWER_UNREADABLE: "unreadable",
}
_CODES = {"not executed": "SHM140", "fate unknown": "SHM141", "unreadable": "SHM142"}


class Use(Notes, ABC):
    """One use of a service or action: its objects, its endpoint in ROS, and its calls.

    Attributes:
        port, side: The use itself: to its carrier, it is both stream and port.
        adopted: Whether :meth:`open` found all objects and kept them.
        events: Events from the ROS side, for the thread of the calls.
        due_ns: When :meth:`turn` is due at the latest.
        feedback: Feedback messages that were passed on.
        goal_status: The state of the open goal, as a word; empty while there is none.
    """

    def __init__(self, plan: CallPlan, context: Context, on_event: Callable[[Use], None]) -> None:
        super().__init__(plan, context)
        self.plan = plan
        self.port = self.side = self
        self._codecs = {part: Codec(plan.layout(part)) for part in plan.parts}
        self.adopted = False
        self.hold = Hold((), lambda *_: None)
        self.events: deque[Any] = deque()
        self.due_ns = 0
        self.received = self.strays = self.feedback = 0
        self.goal_status = ""
        self.counts: Counter[tuple[Outcome, Reason]] = Counter()
        self._on_event = on_event
        self._now = context.clock.monotonic_ns
        self._channels: dict[Part, OwnedChannel] = {}
        self._broken: dict[Part, OwnedChannel] = {}  # those last found to need opening again
        self._writers: dict[Part, Writer] = {}
        self._readers: dict[Part, Reader] = {}
        self._first: set[Part] = set()  # where nothing was written since the claim
        self._known = False  # the objects were open before: no call in them is an earlier bridge's
        self._peer = Peer()
        self._holder = 0  # the claim that the PLC's block was last seen to have

    def watch(self, group: Group) -> list[int]:
        """Let a group report the PLC's messages; return the readers' numbers in the group."""
        readers = self._readers.items()
        return [group.add_reader(reader, self._codecs[part].plan, _REPORT_NEWS) for part, reader in readers]

    @property
    def _writer(self) -> Writer | None:
        """The writer of the first object that the bridge writes; None while nothing is open."""
        return next(iter(self._writers.values()), None)

    @property
    def _reader(self) -> Reader | None:
        """The reader of the first object that the PLC writes; None while nothing is open."""
        return next(iter(self._readers.values()), None)

    @property
    def lively(self) -> bool:
        """Whether the PLC's block sends heartbeats, or a call waits or is open."""
        return self._peer.alive or bool(self._outstanding)

    # -- the objects

    def open(self) -> None:
        """Create or adopt all objects, or none. Raises as :meth:`OwnedChannel.open`."""
        context = self.context
        parts = [
            (describe(self.plan, part, distro=context.distro, bridge=context.bridge), codec.layout.size)
            for part, codec in self._codecs.items()
        ]
        left = None if self._known else self._left()
        opened = OwnedChannel.open_together(
            context.namespace, parts, rights=context.rights, bridge_id=context.bridge_id
        )
        self._channels = dict(zip(self.plan.parts, opened, strict=True))
        self.adopted = opened[0].adopted
        if left is not None and not self.adopted:
            self._bereft(left)
        try:
            own = [part.asks == (self.plan.server == "plc") for part in self.plan.parts]
            pairs = list(zip(own, self._channels.items(), strict=True))
            self._writers = {part: one.writer(context.beat_ms) for mine, (part, one) in pairs if mine}
            self._readers = {part: one.reader(context.beat_ms) for mine, (part, one) in pairs if not mine}
            self._first, self._peer, self._holder = set(self._writers), Peer(), 0
            context.beating[self] = (*self._writers.values(), *self._readers.values())
            self._claimed()
            self._known = True
        except BaseException:
            self.close()
            raise
        for part, channel in self._channels.items():
            if reason := channel.replaced_reason:
                level = logging.WARNING if reason.endswith("]") else logging.INFO
                text = "%s: the %s object was replaced: %s"
                log.log(level, text, self.plan.name, part.word, reason)

    def _left(self) -> Any:
        """Return what an earlier bridge has left open in the existing objects; None if nothing."""
        before, plan = {}, self.plan
        with ExitStack() as stack, suppress(ChannelError, OSError):
            for part in plan.parts:
                where: Any = {"direction": part.direction(plan.server), "part": part, "client": plan.client}
                before[part] = stack.enter_context(attach(self.context.namespace, plan.called, **where))
            return self._found(before)
        return None

    def _found(self, before: Mapping[Part, Mapped]) -> Any:
        """As :meth:`_left`; None for a service, for which nothing remains to be done."""
        return None

    def _bereft(self, left: Any) -> None:
        """End what an earlier bridge has left open in objects that were replaced."""

    @abstractmethod
    def _claimed(self) -> None:
        """Find what an earlier bridge left open, after this bridge has claimed all objects."""

    def _newest(
        self, part: Part, channels: Mapping[Part, Mapped] | None = None
    ) -> tuple[bytes, SlotInfo] | None:
        """Return the newest message of an object, by default of this use, without taking it."""
        channel = (self._channels if channels is None else channels)[part]
        return Reader(channel.region, 0).peek_record()

    def close(self) -> None:
        """Close all objects, which keep their last state."""
        self.context.beating.pop(self, None)
        channels, self._channels, self._writers, self._readers = self._channels, {}, {}, {}
        for channel in channels.values():
            channel.close()

    def retire(self) -> None:
        """Retire all objects: their users are notified, and their names become free."""
        for channel in self._channels.values():
            channel.retire()
        self.close()

    def check(self, now_ns: int) -> bool:
        """Check the objects; return whether they must be opened again."""
        channels, readers = self._channels, self._readers
        if channels and not readers:
            return False  # they are being opened
        try:
            if channels and all(reader.line is not None for reader in readers.values()):
                if all(channel.still_there() for channel in channels.values()):
                    return False
                self.note(now_ns, "an object was removed or replaced; creating all objects again", "SHM120")
        except (ChannelError, ValueError, OSError) as error:
            super().fail(now_ns, error)
        self._broken = channels
        return True

    def fail(self, now_ns: int, error: Exception) -> None:
        """Note an error that makes the current objects unusable."""
        super().fail(now_ns, error)
        self._broken = self._channels

    def reopen(self, now_ns: int) -> bool:
        """Close all objects and open them again, unless already done; return whether this succeeded."""
        if self._channels and self._channels is not self._broken:
            self.problem = ""
            return True
        try:
            self._let_go(now_ns)
            self.close()
            self.open()
        except (RosplcError, OSError, ValueError) as error:
            self.fail(now_ns, error)
            return False
        self.problem = ""
        log.info("%s: the objects are available again", self.plan.name)
        return True

    @abstractmethod
    def _let_go(self, now_ns: int) -> None:
        """End the open call: its objects are about to be closed."""

    # -- the ROS side

    def connect(self, backend: Backend) -> None:
        """Serve the service or action, or become its client. Raises as the backend does; ROS019."""
        if "services" not in backend.capabilities:
            what = f"the {backend.name} backend does not support {self.plan.kind}s"
            raise BackendError("ROS019", what, where=self.plan.called, remedy="Choose another ros.backend.")
        self._endpoint = self._connect(backend)

    @abstractmethod
    def _connect(self, backend: Backend) -> Any:
        """As :meth:`connect`."""

    def disconnect(self) -> None:
        """Remove the endpoint from the ROS graph; a second call does nothing."""
        if self._endpoint is not None:
            self._endpoint.close()

    def tell(self, *event: Any) -> None:
        """Queue an event from the ROS side; callable from any thread."""
        self.events.append(event)
        self._on_event(self)

    def _read(self, part: Part, payload: bytes) -> tuple[bytes, Reason, str]:
        """Convert a payload from ROS to a record; if this fails, return no bytes, and the reason."""
        codec = self._codecs[part]
        try:
            return codec.plan.decode(payload, self.plan.truncate)[0], Reason.NONE, ""
        except Fault as fault:
            explained = codec.explain(fault)
            reason = Reason.TOO_LARGE if fault.args[0] in _TOO_LARGE else Reason.NONE
            return b"", reason, f"{explained.where}: {explained.what}"

    def ask(self, now_ns: int) -> None:
        """Query the state of the ROS endpoint, and show the PLC the number of clients."""
        endpoint, writer = self._endpoint_status(), self._writer
        if endpoint is not None and self.plan.server == "plc" and writer is not None:
            writer.set_sources(endpoint.matched)

    def _endpoint_status(self) -> EndpointStatus | None:
        """Return the endpoint's state; for an action, one for all five, with the peers that have all five."""
        if self._endpoint is None:
            return None
        if self.plan.kind == "service":
            found: EndpointStatus = self._endpoint.status()
            return found
        every: tuple[EndpointStatus, ...] = self._endpoint.endpoints()
        worst = next((one for one in every if one.code), every[0])
        return replace(worst, matched=min(one.matched for one in every))

    # -- the carrier's thread

    def begin(self, now_ns: int) -> None:
        """Prepare for being served."""
        self.due_ns = now_ns

    def flush(self, now_ns: int) -> None:
        """Do nothing: no message is held back."""

    @abstractmethod
    def turn(self, now_ns: int) -> None:
        """Continue all calls as far as possible. Raises ChannelError if the objects must be opened again."""

    @abstractmethod
    def finish(self, now_ns: int) -> None:
        """End calls that have not begun: the use is no longer served."""

    def give_up(self, now_ns: int) -> None:
        """End calls that have begun, too: no other bridge finds them, since the objects will be retired."""
        self._let_go(now_ns)
        self.finish(now_ns)

    def _send(self, record: bytes, part: Part | None = None, *, stamp_ns: int = 0, **words: Any) -> None:
        """Publish a message in one of the objects that the bridge writes, by default the first."""
        if not self._writers:
            raise ChannelError("SHM111", "the objects are not open", where=self.plan.called)
        part = next(iter(self._writers)) if part is None else part
        writer, flags = self._writers[part], spec.FLAG_FIRST if part in self._first else 0
        self._first.discard(part)
        writer.publish(record, flags=flags, stamp_ns=stamp_ns or self.context.clock.time_ns(), **words)

    def _observe(self, claim: int, beat: int, count: int, beat_ms: int, now_ns: int) -> None:
        if claim != self._holder:
            self._holder, self._peer = claim, Peer()
        self._peer.observe(beat, count, beat_ms, now_ns)

    def _count(self, outcome: Outcome, reason: Reason, now_ns: int, text: str = "") -> None:
        self.counts[outcome, reason] += 1
        if outcome in _CODES:
            self.note(now_ns, f"call {outcome}: {text or WORDS[reason]}", _CODES[outcome])

    @property
    @abstractmethod
    def _outstanding(self) -> int:
        """Number of calls that wait or are open."""

    def status(self, now_ns: int) -> ServiceStatus | ActionStatus:
        """Return the current state; callable from any thread."""
        plan, endpoint = self.plan, self._endpoint_status()
        kept = sorted(dict(self.counts).items())

        def by_reason(wanted: Outcome) -> dict[str, int]:
            return {reason.name.lower(): count for (outcome, reason), count in kept if outcome == wanted}

        def total(wanted: Outcome) -> int:
            return sum(by_reason(wanted).values())

        shared: dict[str, Any] = {
            plan.kind: plan.called,
            "type_name": plan.type_name,
            "server": plan.server,
            "client": plan.client,
            "matched": 0 if endpoint is None else endpoint.matched,
            "peer_alive": bool(self._holder) and self._peer.alive,
            "received": self.received,
            "not_executed": by_reason("not executed"),
            "fate_unknown": by_reason("fate unknown"),
            "unreadable": total("unreadable"),
            "late": total("late"),
            "outstanding": self._outstanding,
            "strays": self.strays,
            **self.noted(now_ns, endpoint),
        }
        if plan.kind == "service":
            return ServiceStatus(**shared, done=total("done"))
        return ActionStatus(
            **shared,
            succeeded=total("succeeded"),
            aborted=total("aborted"),
            canceled=total("canceled"),
            feedback=self.feedback,
            goal_status=self.goal_status,
        )
