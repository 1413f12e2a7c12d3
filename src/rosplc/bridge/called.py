"""What the PLC calls: the bridge is the answerer towards the PLC."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable
from contextlib import suppress
from typing import Any

from rosplc.bridge.port import Context, log
from rosplc.bridge.use import ENDINGS, IDLE_NS, LOOK_NS, Outcome, Use
from rosplc.config.plans import ServicePlan
from rosplc.errors import RosplcError
from rosplc.reasons import Reason
from rosplc.ros import Backend, Reply, ServiceClient
from rosplc.shm import Answerer, Part, Reader, SlotInfo
from rosplc.shm.constants import ASK_WITHDRAWN, WRITER_LINE

_MOST_LOOKS = 8  # in one turn, at an object that is written all the time
_ANSWERS = {outcome: answer for answer, outcome in ENDINGS.items()}


class Asked(Use):
    """A service or action that the PLC calls, one call at a time."""

    def __init__(self, plan: Any, context: Context, on_event: Callable[[Use], None]) -> None:
        super().__init__(plan, context, on_event)
        self._open_call: int | None = None  # its correlation
        self._client = b""  # what the PLC has put into its message
        self._answerer: Answerer | None = None
        self._ready: bool | None = None
        self._asks, self._answers = plan.parts[:2]
        self._initial = bytes(plan.layout(self._answers).initial())

    @property
    def _outstanding(self) -> int:
        return int(self._open_call is not None)

    @property
    def _epoch(self) -> int:
        """The life of the PLC's program; 0 while there is none."""
        return self._channels[self._asks].region.word(WRITER_LINE["writer_epoch"])

    # -- the PLC's side

    def turn(self, now_ns: int) -> None:
        """Go on with the call."""
        writer, reader, answerer, client = self._writer, self._reader, self._answerer, self._endpoint
        if writer is None or reader is None or answerer is None:
            return
        head, epoch, beat, beat_ms = self._channels[self._asks].region.words(WRITER_LINE["head"], 4)
        self._observe(epoch, beat, head, beat_ms, now_ns)
        self._hear(now_ns)
        ready = client is not None and client.ready
        if ready is not self._ready:
            writer.set_sources(int(ready))
            reader.set_sinks(int(ready))
            self._ready = ready
        if self._open_call is not None and self._deserted(epoch):
            self._give_up(Reason.PLC_DOWN, now_ns)
        waits = head != reader.last
        if waits and epoch and self._peer.alive and (ready or self._open_call is not None):
            self._take(reader, answerer, now_ns)
        self.due_ns = now_ns + (LOOK_NS if waits or self._open_call is not None else IDLE_NS)

    def _deserted(self, epoch: int) -> bool:
        """Whether the open call is of another life of the PLC's program: what it calls has other numbers."""
        return self._open_call is not None and self._open_call >> 32 != epoch

    def _take(self, reader: Reader, answerer: Answerer, now_ns: int) -> None:
        for _ in range(_MOST_LOOKS):
            if (found := reader.latest_wire(self._codecs[self._asks].plan)) is None:
                return
            payload, info = found
            # Behind the message, or the first call of a program that has just started would be lost.
            if info.correlation >> 32 != self._epoch:
                continue  # of another life of the PLC's program
            what = answerer.take(info)
            if what == "more":
                self._more(info, now_ns)
            elif what:
                if self._open_call is not None:
                    self._give_up(Reason.CALLER_GONE, now_ns)
                self.received += 1
                self._open_call, self._client = info.correlation, info.client
                self._begin(what, payload, info, now_ns)

    def _begin(self, what: str, payload: bytes, info: SlotInfo, now_ns: int) -> None:
        """Act on a new call of the PLC's."""
        if what == "withdrawn":
            self._answer("not executed", Reason.CALLER_GONE, now_ns)
        elif what == "unknown":
            self._answer("fate unknown", Reason.BRIDGE_RESTARTED, now_ns)
        elif self._endpoint is None:
            self._answer("not executed", Reason.NO_SERVER, now_ns)
        else:
            try:
                self._call(payload, info)
            except RosplcError as error:
                self._answer("not executed", Reason.REJECTED, now_ns, error.what)
            except Exception as error:  # a defect, or no more threads; but the PLC waits for an end
                log.debug("%s: a request was not sent", self.plan.name, exc_info=True)
                self._answer("fate unknown", Reason.NONE, now_ns, f"{type(error).__name__}: {error}")

    @abstractmethod
    def _call(self, payload: bytes, info: SlotInfo) -> None:
        """Send the open call to its server."""

    @abstractmethod
    def _more(self, info: SlotInfo, now_ns: int) -> None:
        """Act on a newer message of the open call."""

    def _answer(
        self,
        outcome: Outcome,
        reason: Reason,
        now_ns: int,
        text: str = "",
        record: bytes = b"",
        status: int = 0,
    ) -> None:
        """End the open call with its one answer; it remains open if that cannot be sent."""
        number = self._open_call
        assert number is not None and self._answerer is not None
        status = status or _ANSWERS[outcome]
        record = record or self._initial
        self._send(record, correlation=number, status=status, client=self._client, reason=reason)
        self._open_call = None
        self._answerer.answered(number)
        self._count(outcome, reason, now_ns, text)

    # -- the ROS side

    @abstractmethod
    def _hear(self, now_ns: int) -> None:
        """Pass on what the ROS side has told."""

    # -- beginning and end

    @abstractmethod
    def _give_up(self, reason: Reason, now_ns: int) -> None:
        """Wait no longer for ROS: the call may have been executed."""

    def _claimed(self) -> None:
        answers = self._channels[self._answers]
        self._answerer = Answerer(self._channels[self._asks], self._readers[self._asks], answers)
        self._ready = None
        before, self._open_call = self._open_call, None  # its answer is awaited, or could not be sent
        number, now = self._answerer.unanswered, self._now()
        lives = bool(number) and number >> 32 == self._epoch
        if before is not None and not (lives and number == before):
            self._count("fate unknown", Reason.BRIDGE_RESTARTED, now)
        if lives:
            self.received += number != before
            self._open_call = number
        self._resume(number, lives, now)

    @abstractmethod
    def _resume(self, number: int, lives: bool, now_ns: int) -> None:
        """Go on with a call that may have been begun, 0: none; ``lives``: the program that called does."""

    def finish(self, now_ns: int) -> None:
        """Leave the open call."""
        self._let_go(now_ns)


class Called(Asked):
    """A service that the PLC calls."""

    plan: ServicePlan
    _endpoint: ServiceClient | None
    _sent: int | None = None
    """The open call's number in ROS; that of an earlier one does no harm."""

    def _connect(self, backend: Backend) -> ServiceClient:
        plan = self.plan
        return backend.client(plan.service, plan.type_name, plan.qos)

    def _call(self, payload: bytes, info: SlotInfo) -> None:
        assert self._endpoint is not None
        self._sent = self._endpoint.call(payload, lambda reply: self.tell(info.correlation, reply))

    def _more(self, info: SlotInfo, now_ns: int) -> None:
        if info.status & ASK_WITHDRAWN:
            self._give_up(Reason.CALLER_GONE, now_ns)

    def _hear(self, now_ns: int) -> None:
        for _ in range(len(self.events)):
            correlation, reply = self.events.popleft()
            if correlation == self._open_call:
                self._pass_on(reply, now_ns)

    def _pass_on(self, reply: Reply, now_ns: int) -> None:
        if reply.payload is None:
            self._answer(reply.outcome, reply.reason, now_ns, reply.text)
            return
        record, reason, text = self._read(Part.RESPONSE, reply.payload)
        self._answer("unreadable" if text else "done", reason, now_ns, text, record)

    def _give_up(self, reason: Reason, now_ns: int) -> None:
        if self._sent is not None and self._endpoint is not None:
            self._endpoint.forget(self._sent)
            self._sent = None
        self._answer("fate unknown", reason, now_ns)

    def _resume(self, number: int, lives: bool, now_ns: int) -> None:
        if lives:
            self._answer("fate unknown", Reason.BRIDGE_RESTARTED, now_ns)

    def _let_go(self, now_ns: int) -> None:
        with suppress(RosplcError, OSError, ValueError, AssertionError):
            self._hear(now_ns)
            if self._open_call is not None:
                self._give_up(Reason.BRIDGE_RESTARTED, now_ns)
