"""One use of a service, as its thread sees it: its objects, its endpoint in ROS, and its calls' counts."""

from __future__ import annotations

import logging
from abc import ABC, abstractmethod
from collections import Counter, deque
from collections.abc import Callable
from contextlib import suppress
from typing import Any, Literal

from rosplc.bridge.hold import Hold
from rosplc.bridge.port import Context, Notes, log
from rosplc.bridge.status import ServiceStatus
from rosplc.codec import Codec, Wire
from rosplc.config.calls import ServicePlan
from rosplc.config.resolve import describe_call
from rosplc.errors import BackendError, ChannelError, RosplcError
from rosplc.reasons import Reason
from rosplc.ros import Backend, ServiceClient, ServiceServer
from rosplc.shm import Group, OwnedChannel, Part, Peer, Reader, SlotInfo, Writer
from rosplc.shm.calls import WORDS
from rosplc.shm.constants import (
    ANSWER_DONE,
    ANSWER_FATE_UNKNOWN,
    ANSWER_NOT_EXECUTED,
    ANSWER_UNREADABLE,
    FLAG_FIRST,
)

_REPORT_NEWS = 2
LOOK_NS = 5_000_000
"""Time between two looks at the peers of a use with a call that waits or is open."""
IDLE_NS = 100_000_000
"""The same without one."""
TOO_LARGE = (4, 5, 8)
"""Faults of a codec: a string or sequence exceeds a limit."""

Outcome = Literal["done", "not executed", "fate unknown", "unreadable", "late"]
ENDINGS: dict[int, Outcome] = {
    ANSWER_DONE: "done",
    ANSWER_NOT_EXECUTED: "not executed",
    ANSWER_FATE_UNKNOWN: "fate unknown",
    ANSWER_UNREADABLE: "unreadable",
}
_CODES = {"not executed": "SHM140", "fate unknown": "SHM141", "unreadable": "SHM142"}


class Use(Notes, ABC):
    """One use of a service: its two objects, its endpoint in ROS, and its calls.

    To its carrier it is stream and port at once.

    Attributes:
        outgoing: The object that the bridge writes.
        incoming: The object that the PLC writes.
        adopted: Whether :meth:`open` found both objects and kept them.
        events: What the ROS side has told, for the thread of the calls.
        due_ns: When :meth:`turn` is wanted at the latest.
    """

    outgoing: Part
    incoming: Part

    def __init__(self, plan: ServicePlan, context: Context, on_event: Callable[[Use], None]) -> None:
        super().__init__(plan, context)
        self.plan = plan
        wire = Wire.ROS1 if plan.request.store.ros_version == 1 else Wire.CDR
        self._codecs = {Part.REQUEST: Codec(plan.request, wire), Part.RESPONSE: Codec(plan.response, wire)}
        self.adopted = False
        self.hold = Hold((), lambda *_: None)
        self.events: deque[Any] = deque()
        self.due_ns = 0
        self.received = self.strays = 0
        self.counts: Counter[tuple[Outcome, Reason]] = Counter()
        self._on_event = on_event
        self._now = context.clock.monotonic_ns
        self._channels: tuple[OwnedChannel, ...] = ()
        self._broken: tuple[OwnedChannel, ...] = ()  # those last found to need opening again
        self._writer: Writer | None = None
        self._reader: Reader | None = None
        self._first = True  # nothing was written since the claim
        self._known = False  # the objects were open before: no call in them is an earlier bridge's
        self._peer = Peer()
        self._holder = 0  # the claim that the PLC's block was last seen to have
        self._endpoint: ServiceServer | ServiceClient | None = None

    @property
    def port(self) -> Use:
        """The use itself."""
        return self

    @property
    def side(self) -> Use:
        """The use itself."""
        return self

    def watch(self, group: Group) -> int | None:
        """Have a group tell of the PLC's messages; return its number there, None while nothing is open."""
        plan = self._codecs[self.incoming].plan
        return None if self._reader is None else group.add_reader(self._reader, plan, _REPORT_NEWS)

    @property
    def lively(self) -> bool:
        """Whether the PLC's block beats, or a call waits or is open."""
        return self._peer.alive or bool(self._outstanding)

    # -- the objects

    def open(self) -> None:
        """Create or adopt both objects, or neither. Raises as :meth:`OwnedChannel.open`."""
        context = self.context
        parts = [
            (describe_call(self.plan, part, context.distro, context.bridge), codec.layout.size)
            for part, codec in self._codecs.items()
        ]
        opened = OwnedChannel.open_together(
            context.namespace, parts, **vars(context.rights), bridge_id=context.bridge_id
        )
        out, into = sorted(opened, key=lambda channel: channel.description.part is self.incoming)
        self._channels, self.adopted = (out, into), out.adopted
        try:
            self._writer, self._reader = out.writer(context.beat_ms), into.reader(context.beat_ms)
            self._first, self._peer, self._holder = True, Peer(), 0
            self._claimed(self._writer, self._reader)
        except BaseException:
            self.close()
            raise
        for channel in opened:
            if reason := channel.replaced_reason:
                level = logging.WARNING if reason.endswith("]") else logging.INFO
                log.log(
                    level,
                    "%s: the %s object was replaced: %s",
                    self.plan.name,
                    channel.description.part.word,
                    reason,
                )

    @abstractmethod
    def _claimed(self, writer: Writer, reader: Reader) -> None:
        """Both objects are this bridge's; find what an earlier one left open."""

    def _newest(self, channel: OwnedChannel) -> tuple[bytes, SlotInfo] | None:
        """Return the newest message of one of the objects, and take nothing."""
        record = bytearray(channel.identity.record_size)
        info = Reader(channel.region, 0).peek(record)
        return None if info is None else (bytes(record), info)

    def close(self) -> None:
        """Leave both objects with their last state."""
        channels, self._channels, self._writer, self._reader = self._channels, (), None, None
        for channel in channels:
            channel.close()

    def retire(self) -> None:
        """Give both objects up: their users are told, and their names are free."""
        for channel in self._channels:
            channel.retire()
        self.close()

    def beat(self) -> None:
        """Show that this side lives; from any thread."""
        for user in (self._writer, self._reader):
            if user is not None:
                with suppress(ValueError):  # closed at this moment
                    user.beat()

    def check(self, now_ns: int) -> bool:
        """Look after the objects; return whether they must be opened again."""
        channels, reader = self._channels, self._reader
        if channels and reader is None:
            return False  # they are being opened
        try:
            if channels and reader is not None and reader.line is not None:
                if all(channel.still_there() for channel in channels):
                    return False
                self.note(now_ns, "an object was removed or replaced; both are created again", "SHM120")
        except (ChannelError, ValueError, OSError) as error:
            super().fail(now_ns, error)
        self._broken = channels
        return True

    def fail(self, now_ns: int, error: Exception) -> None:
        """Remember an error that keeps the present objects from being used."""
        super().fail(now_ns, error)
        self._broken = self._channels

    def reopen(self, now_ns: int) -> bool:
        """Close both objects and open them again, unless they were since; return whether that succeeded."""
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
        """End the open call: its objects are about to be left."""

    # -- the ROS side

    def connect(self, backend: Backend) -> None:
        """Serve the service, or become its client. Raises as the backend does; BackendError ROS019."""
        if "services" not in backend.capabilities:
            what = f"the {backend.name} backend carries no services"
            raise BackendError("ROS019", what, where=self.plan.service, remedy="Choose another ros.backend.")
        self._endpoint = self._connect(backend)

    @abstractmethod
    def _connect(self, backend: Backend) -> ServiceServer | ServiceClient:
        """As :meth:`connect`."""

    def disconnect(self) -> None:
        """Take the endpoint off the graph; harmless twice."""
        if self._endpoint is not None:
            self._endpoint.close()

    def tell(self, *event: Any) -> None:
        """Take an event of the ROS side's; from any thread."""
        self.events.append(event)
        self._on_event(self)

    def ask(self, now_ns: int) -> None:
        """Ask the ROS side how the endpoint stands, and show the PLC how many clients there are."""
        endpoint, writer = self._endpoint, self._writer
        if endpoint is not None and self.plan.server == "plc" and writer is not None:
            writer.set_sources(endpoint.status().matched)

    # -- the carrier's thread

    def begin(self, now_ns: int) -> None:
        """The use is about to be served."""
        self.due_ns = now_ns

    def flush(self, now_ns: int) -> None:
        """Nothing is held back."""

    @abstractmethod
    def turn(self, now_ns: int) -> None:
        """Go on with all calls as far as possible. Raises ChannelError: The objects must be opened again."""

    @abstractmethod
    def finish(self, now_ns: int) -> None:
        """End what has not begun: the use is not served any more."""

    def give_up(self, now_ns: int) -> None:
        """End what has begun too: the objects are about to be retired, and no other bridge finds it."""
        self._let_go(now_ns)
        self.finish(now_ns)

    def _send(
        self, record: bytes, *, correlation: int, status: int, client: bytes = b"", reason: int = 0
    ) -> None:
        writer = self._writer
        assert writer is not None
        flags, self._first = (FLAG_FIRST if self._first else 0), False
        words = {"correlation": correlation, "status": status, "reason": reason, "flags": flags}
        writer.publish(record, client=client, stamp_ns=self.context.clock.time_ns(), **words)

    def _observe(self, claim: int, beat: int, count: int, beat_ms: int, now_ns: int) -> None:
        if claim != self._holder:
            self._holder, self._peer = claim, Peer()
        self._peer.observe(beat, count, beat_ms, now_ns)

    def _count(self, outcome: Outcome, reason: Reason, now_ns: int, text: str = "") -> None:
        self.counts[outcome, reason] += 1
        if outcome in _CODES:
            words = f"call {'' if outcome == 'unreadable' else 'ended as '}{outcome}"
            self.note(now_ns, f"{words}: {text or WORDS[reason]}", _CODES[outcome])

    @property
    @abstractmethod
    def _outstanding(self) -> int:
        """Calls that wait or are open."""

    def status(self, now_ns: int) -> ServiceStatus:
        """Return the present state; from any thread."""
        plan, endpoint = self.plan, None if self._endpoint is None else self._endpoint.status()
        counts = sorted(dict(self.counts).items())

        def by_reason(wanted: Outcome) -> dict[str, int]:
            return {reason.name.lower(): count for (outcome, reason), count in counts if outcome == wanted}

        return ServiceStatus(
            service=plan.service,
            type_name=plan.type_name,
            server=plan.server,
            client=plan.client,
            matched=0 if endpoint is None else endpoint.matched,
            peer_alive=bool(self._holder) and self._peer.alive,
            received=self.received,
            done=sum(by_reason("done").values()),
            not_executed=by_reason("not executed"),
            fate_unknown=by_reason("fate unknown"),
            unreadable=sum(by_reason("unreadable").values()),
            late=sum(by_reason("late").values()),
            outstanding=self._outstanding,
            strays=self.strays,
            **self.noted(now_ns, endpoint),
        )
