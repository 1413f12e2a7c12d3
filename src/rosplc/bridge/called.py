"""Services that the PLC calls: the bridge is the answerer towards the PLC."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress

from rosplc.bridge.port import Context, log
from rosplc.bridge.use import ENDINGS, IDLE_NS, LOOK_NS, TOO_LARGE, Outcome, Use
from rosplc.codec import Fault
from rosplc.config.calls import ServicePlan
from rosplc.errors import RosplcError
from rosplc.reasons import Reason
from rosplc.ros import Backend, Reply, ServiceClient
from rosplc.shm import Answerer, Part, Reader
from rosplc.shm.constants import ASK_WITHDRAWN, WRITER_LINE

_ANSWERS = {outcome: answer for answer, outcome in ENDINGS.items()}


class Called(Use):
    """A service that the PLC calls: the bridge is the answerer towards the PLC."""

    plan: ServicePlan
    _endpoint: ServiceClient | None

    def __init__(self, plan: ServicePlan, context: Context, on_event: Callable[[Use], None]) -> None:
        super().__init__(plan, context, on_event)
        self._open_call: int | None = None  # its correlation
        self._sent: int | None = None  # its number in ROS; None once it is forgotten
        self._answerer: Answerer | None = None
        self._ready: bool | None = None
        self._initial = bytes(plan.response.initial())

    def _connect(self, backend: Backend) -> ServiceClient:
        plan = self.plan
        return backend.client(plan.service, plan.type_name, plan.qos)

    @property
    def _outstanding(self) -> int:
        return int(self._open_call is not None)

    def turn(self, now_ns: int) -> None:
        """Go on with the call."""
        if self._writer is None or self._reader is None or self._answerer is None:
            return
        head, epoch, beat, beat_ms = self._channels[Part.REQUEST].region.words(WRITER_LINE["head"], 4)
        self._observe(epoch, beat, head, beat_ms, now_ns)
        self._hear(now_ns)
        client = self._endpoint
        ready = client is not None and client.ready
        if ready is not self._ready:
            self._writer.set_sources(int(ready))
            self._reader.set_sinks(int(ready))
            self._ready = ready
        if self._open_call is not None and self._open_call >> 32 != epoch:
            # Another life of the PLC's program: what it calls has other numbers.
            self._give_up(Reason.PLC_DOWN, now_ns)
        waits = head != self._reader.last
        if waits and epoch and self._peer.alive and (ready or self._open_call is not None):
            self._take(self._reader, self._answerer, now_ns)
        self.due_ns = now_ns + (LOOK_NS if waits or self._open_call is not None else IDLE_NS)

    def _hear(self, now_ns: int) -> None:
        """Pass on what the ROS side has told."""
        while self.events:
            correlation, reply = self.events.popleft()
            if correlation == self._open_call:
                self._pass_on(reply, now_ns)

    def _take(self, reader: Reader, answerer: Answerer, now_ns: int) -> None:
        asks = self._channels[Part.REQUEST].region
        while (found := reader.latest_wire(self._codecs[Part.REQUEST].plan)) is not None:
            payload, info = found
            # Behind the message, or the first call of a program that has just started would be lost.
            if info.correlation >> 32 != asks.word(WRITER_LINE["writer_epoch"]):
                continue  # of another life of the PLC's program
            what = answerer.take(info)
            if what == "more" and info.status & ASK_WITHDRAWN:
                self._give_up(Reason.CALLER_GONE, now_ns)
            elif what not in ("", "more"):
                if self._open_call is not None:
                    self._give_up(Reason.CALLER_GONE, now_ns)
                self._begin(what, payload, info.correlation, now_ns)

    def _begin(self, what: str, payload: bytes, number: int, now_ns: int) -> None:
        """Act on a new call of the PLC's."""
        self.received += 1
        self._open_call, client = number, self._endpoint
        if what == "withdrawn":
            self._answer("not executed", Reason.CALLER_GONE, now_ns)
        elif what == "unknown":
            self._answer("fate unknown", Reason.BRIDGE_RESTARTED, now_ns)
        elif client is None:
            self._answer("not executed", Reason.NO_SERVER, now_ns)
        else:
            try:
                self._sent = client.call(payload, lambda reply: self.tell(number, reply))
            except RosplcError as error:
                self._answer("not executed", Reason.REJECTED, now_ns, error.what)
            except Exception as error:  # a defect, or no more threads; but the PLC waits for an end
                log.debug("%s: a request was not sent", self.plan.name, exc_info=True)
                self._answer("fate unknown", Reason.NONE, now_ns, f"{type(error).__name__}: {error}")

    def _pass_on(self, reply: Reply, now_ns: int) -> None:
        if reply.payload is None:
            self._answer(reply.outcome, reply.reason, now_ns, reply.text)
            return
        codec = self._codecs[Part.RESPONSE]
        try:
            record = codec.plan.decode(reply.payload, self.plan.truncate)[0]
        except Fault as fault:
            explained = codec.explain(fault)
            reason = Reason.TOO_LARGE if fault.args[0] in TOO_LARGE else Reason.NONE
            self._answer("unreadable", reason, now_ns, f"{explained.where}: {explained.what}")
        else:
            self._answer("done", Reason.NONE, now_ns, record=record)

    def _answer(
        self, outcome: Outcome, reason: Reason, now_ns: int, text: str = "", record: bytes = b""
    ) -> None:
        """End the open call with its one answer; it remains open if that cannot be sent."""
        number = self._open_call
        assert number is not None and self._answerer is not None
        self._send(record or self._initial, correlation=number, status=_ANSWERS[outcome], reason=reason)
        self._open_call = self._sent = None
        self._answerer.answered(number)
        self._count(outcome, reason, now_ns, text)

    def _give_up(self, reason: Reason, now_ns: int) -> None:
        """Wait no longer for ROS: the call may have been executed."""
        if self._sent is not None and self._endpoint is not None:
            self._endpoint.forget(self._sent)
        self._answer("fate unknown", reason, now_ns)

    def _claimed(self) -> None:
        asks, reader = self._channels[Part.REQUEST], self._readers[Part.REQUEST]
        self._answerer = Answerer(asks, reader, self._channels[Part.RESPONSE])
        self._ready = None
        before, self._open_call = self._open_call, None  # its answer could not be sent
        number = self._answerer.unanswered
        if before not in (None, number):
            self._count("fate unknown", Reason.BRIDGE_RESTARTED, self._now())
        if number and number >> 32 == asks.region.word(WRITER_LINE["writer_epoch"]):
            self.received += number != before
            self._open_call = number
            self._answer("fate unknown", Reason.BRIDGE_RESTARTED, self._now())

    def _let_go(self, now_ns: int) -> None:
        with suppress(RosplcError, OSError, ValueError, AssertionError):
            self._hear(now_ns)
            if self._open_call is not None:
                self._give_up(Reason.BRIDGE_RESTARTED, now_ns)

    def finish(self, now_ns: int) -> None:
        """Answer the open call: nobody waits for ROS any more."""
        self._let_go(now_ns)
