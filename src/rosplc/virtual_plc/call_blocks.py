"""The Server and Client blocks: services, as a program in a PLC carries them out or calls them."""

from __future__ import annotations

import time
from contextlib import suppress
from functools import partial
from typing import Any

from rosplc.errors import ChannelError
from rosplc.layout import Layout, RecordView
from rosplc.reasons import Reason
from rosplc.shm import (
    Attached,
    Caller,
    Direction,
    Namespace,
    Part,
    Peer,
    Reader,
    ReaderClaim,
    SlotInfo,
    Writer,
)
from rosplc.shm.constants import (
    ANSWER_DONE,
    ANSWER_FATE_UNKNOWN,
    ANSWER_NOT_EXECUTED,
    ANSWER_UNREADABLE,
    ASK_WITHDRAWN,
    STAMP_PLC,
    UNKNOWN,
    ErrorNumber,
)
from rosplc.virtual_plc.block import Block
from rosplc.virtual_plc.task import Scan
from rosplc.virtual_plc.write_block import Message, WriteBlock

__all__ = ["ServiceClient", "ServiceServer"]

_OUTCOMES = {
    ANSWER_NOT_EXECUTED: ErrorNumber.NOT_EXECUTED,
    ANSWER_FATE_UNKNOWN: ErrorNumber.FATE_UNKNOWN,
    ANSWER_UNREADABLE: ErrorNumber.UNREADABLE,
}


class _In(Block):
    """Takes the messages of one of a service's objects, the newest alone, once reader line 0 is this block's.

    Attributes:
        fresh: Nothing was taken yet since the object was opened.
        msg: A copy of the message taken last.
        sources: What the bridge says of its ROS side; None if unknown.
    """

    def __init__(self, part: Part, client: str, *arguments: Any) -> None:
        super().__init__(*arguments)
        self._part, self._client = part, client
        self.xReady = False
        self.fresh = True
        self.msg: RecordView | None = None
        self.sources: int | None = None
        self._claim: ReaderClaim | None = None
        self._reader: Reader | None = None

    def look(self, scan: Scan) -> None:
        """Open the object, claim the line, and watch the bridge."""
        attached = self._follow(scan)
        try:
            if attached is not None:
                self._watch(attached, scan)
        except ChannelError as error:  # retired between the check and the claim, or not readable
            self._drop(error)
        self.xAttached = self._attached is not None
        if not self.xAttached:
            self._reader = self._claim = self.sources = None
            self.xPeerAlive = False
        # In place of a silent bridge's object another may just have been opened, for the next scan.
        self.xReady = self.xAttached and self._claim is None and self._opened == self._opened_times
        self.udiError, self.reason = self._failure
        self._report_silence()

    def _watch(self, attached: Attached, scan: Scan) -> None:
        if self._opened_times != self._opened:
            self._opened, self._peer, self.fresh = self._opened_times, Peer(), True
            self._reader = attached.reader()
            answers, lines = self._part is Part.REQUEST, range(1)
            region, beat_ms = attached.region, self._beat_ms
            self._claim = ReaderClaim(region, self._reader, beat_ms, scan.task, lines, answer=answers)
        assert self._reader is not None
        if self._claim is not None and self._claim.attempt(scan.now_ns):
            self._claim = None
        self._reader.beat()
        state = attached.snapshot().writer
        self._peer.observe(state.beat, state.head, state.beat_ms, scan.now_ns)
        self.xPeerAlive = self._peer.alive
        self.sources = state.sources if self.xPeerAlive and state.sources != UNKNOWN else None
        if self._peer.silent:
            self._look_for_another(scan)

    def take(self) -> SlotInfo | None:
        """Take what is new; ``msg`` is a copy of it."""
        layout, reader = self.layout, self._reader
        if not self.xReady or reader is None or layout is None:
            return None
        record = bytearray(layout.size)
        try:
            info = reader.latest(record)
        except ChannelError as error:
            self._drop(error)
            self.xReady = False
            return None
        if info is not None:
            self.msg = layout.view(record)
        return info

    def begin(self) -> bool:
        """Return whether the call that was taken may be acted on (M26)."""
        try:
            return self.xReady and self._reader is not None and self._reader.begin()
        except ChannelError as error:  # retired since it was looked at
            self._drop(error)
            self.xReady = False
            return False

    @property
    def object(self) -> int:
        """Which object is open; 0 none."""
        return 0 if self._attached is None else self._opened

    def close(self) -> None:
        """Give the line back and let go of the object."""
        if self._reader is not None:
            self._reader.release()
        self._detach()
        self._reader = self._claim = None


class _Out(WriteBlock):
    """Writes the messages of one of a service's objects."""

    def __init__(self, part: Part, client: str, *arguments: Any, **more: Any) -> None:
        super().__init__(*arguments, **more)
        self._part, self._client = part, client

    @property
    def open(self) -> tuple[Attached, Writer] | None:
        """The object and its writer; None without the claim."""
        attached, writer = self._attached, self._writer
        return (
            None
            if attached is None or writer is None or self._opened != self._opened_times
            else (attached, writer)
        )

    def publish(self, message: Any, **words: Any) -> None:
        """Send a message; ``words`` are what its slot says of the call. Raises ChannelError: Not sent."""
        found, layout = self.open, self.layout
        if found is None or layout is None:
            raise ChannelError("SHM111", "the object is not open", where=self.topic)
        record = layout.pack(message)
        found[1].publish(record, stamp_ns=time.monotonic_ns(), stamp_clock=STAMP_PLC, **words)


class _ServiceBlock:
    """What both blocks share: their objects, and what is wrong with them.

    Attributes:
        xAttached: Both objects are open, and this block's.
        xPeerAlive: The bridge beats.
        udiError: 0, or a number of spec/shm-format.md, section 9.
        reason: ``udiError`` in words.
    """

    def __init__(
        self,
        service: str,
        client: str,
        parts: tuple[Part, Part],
        layouts: tuple[Layout | None, Layout | None],
        prefix: str,
        directory: str,
        beat_ms: int,
    ) -> None:
        self.service = service
        self.xAttached = self.xPeerAlive = False
        self.udiError = 0
        self.reason = ""
        taken, sent = parts
        names = Namespace(prefix, directory)
        self._in = _In(taken, client, service, names, Direction.TO_PLC, layouts[0], beat_ms)
        where: Any = {"prefix": prefix, "directory": directory, "beat_ms": beat_ms}
        self._out = _Out(sent, client, service, layout=layouts[1], **where)

    @property
    def xError(self) -> bool:
        """Whether ``udiError`` is not 0."""
        return self.udiError != 0

    @property
    def eError(self) -> ErrorNumber | None:
        """``udiError`` by its name; None while it is 0."""
        return ErrorNumber(self.udiError) if self.udiError else None

    def _look(self, scan: Scan) -> None:
        self._in.look(scan)
        self._out._run(scan)
        self.xAttached = self._in.xReady and self._out.xReady
        self.xPeerAlive = self._in.xPeerAlive and self._out.xPeerAlive
        wrong: Block = self._out if self._out.udiError else self._in
        self.udiError, self.reason = wrong.udiError, wrong.reason

    def close(self) -> None:
        """Give the claims back and let go of both objects; the next call opens them again."""
        self._in.close()
        self._out.close()


class ServiceServer(_ServiceBlock):
    """Carries out a service that ROS calls; the stand-in for a generated ``<pkg>_<Srv>_Server``.

    Call the instance in every scan. While ``xRequest`` is set, ``request`` is to be carried out; a rising
    edge of ``xReply`` sends ``response``, one of ``xReject`` refuses. A call waits for nothing.

    Args:
        service: The service as ROS writes it.
        request: The compiled-in layout, as a PLC has it; None takes the object's own description.
        response: The same of the response.
        prefix: The bridge's ``prefix:``.
        directory: Where the objects stand.
        beat_ms: The longest time between two calls that this block promises.

    Attributes:
        xReply: Input: the call is done, send ``response``.
        xReject: Input: the call was not and will not be carried out.
        response: Input: the answer; None before its type is known.
        xRequest: A call is to be carried out; False for one scan at least between two calls.
        request: What is asked.
        xCallerGone: Nobody waits for the answer any more; the call is to be ended all the same.
        age: Seconds since the call was shown.
        udiCalls: Calls shown since the start.
    """

    def __init__(
        self,
        service: str,
        *,
        request: Layout | None = None,
        response: Layout | None = None,
        prefix: str = "rosplc",
        directory: str = "/dev/shm",
        beat_ms: int = 1000,
    ) -> None:
        parts = (Part.REQUEST, Part.RESPONSE)
        super().__init__(service, "", parts, (request, response), prefix, directory, beat_ms)
        self.xReply = self.xReject = self.xRequest = self.xCallerGone = False
        self.response: Any = None if response is None else Message.initial(response)
        self.request: RecordView | None = None
        self.age = 0.0
        self.udiCalls = 0
        self._inputs = (False, False)
        self._waiting: SlotInfo | None = None  # taken, and neither shown nor refused
        self._shown: SlotInfo | None = None
        self._answer: partial[None] | None = None  # to be sent as soon as the object is open
        self._ended = 0  # the correlation of the call answered last
        self._orphan = False  # the object of the call that is shown is gone
        self._object = self._since_ns = 0

    def __call__(self) -> bool:
        """Run the block once and return ``xRequest``.

        Raises:
            LayoutError: LAY006, if a value in ``response`` does not fit its field; the call stays open.
        """
        with self._out._entered() as scan:
            if scan is not None:
                self._run(scan)
        return self.xRequest

    def _run(self, scan: Scan) -> None:
        ends, shown_before = self._edges(), self._shown is not None
        self._look(scan)
        if self._in.xReady and self._in.object != self._object:
            # The bridge has ended what the object before held.
            self._object, self._waiting, self._answer = self._in.object, None, None
            self._orphan = self.xCallerGone = self._shown is not None
        if self._out.xReady and self._answer is None:
            self._take(scan)
        if self.response is None and self._out.layout is not None:
            self.response = Message.initial(self._out.layout)
        if ends is not None and shown_before:
            self._end(*ends)
        elif ends is not None:
            self.udiError, self.reason = ErrorNumber.ILLEGAL_STEP.value, "there is no call to be ended"
        if self._answer is not None:
            with suppress(ChannelError):  # in a later scan
                self._answer()
                self._answer = None
        self.xRequest = self._shown is not None
        self.age = (scan.now_ns - self._since_ns) / 1e9 if self.xRequest else 0.0

    def _edges(self) -> tuple[int, Reason] | None:
        before, self._inputs = self._inputs, (self.xReply, self.xReject)
        if self.xReply and not before[0]:
            return ANSWER_DONE, Reason.NONE
        return (ANSWER_NOT_EXECUTED, Reason.REJECTED) if self.xReject and not before[1] else None

    def _take(self, scan: Scan) -> None:
        info, shown = self._in.take(), self._shown
        if info is not None:
            fresh, self._in.fresh = self._in.fresh, False
            if info.correlation == self._ended:
                pass  # it has its answer, and only the newest is read
            elif shown is not None and info.correlation == shown.correlation and not self._orphan:
                self.xCallerGone = self.xCallerGone or bool(info.status & ASK_WITHDRAWN)
            elif info.status & ASK_WITHDRAWN:
                self._waiting = None  # this very call, or one that has ended
                # One that was there before this block's claim may have been begun by an earlier program.
                unknown = ANSWER_FATE_UNKNOWN, Reason.PLC_DOWN
                self._put(info, *(unknown if fresh else (ANSWER_NOT_EXECUTED, Reason.CALLER_GONE)))
            else:
                self._waiting = info
                self.xCallerGone = shown is not None
        if self._waiting is not None and shown is None:
            info, self._waiting = self._waiting, None
            if self._in.begin() and self._in.msg is not None:
                self._shown, self.request = info, self._in.msg
                self._since_ns, self.xCallerGone, self._orphan = scan.now_ns, False, False
                self.udiCalls += 1

    def _end(self, status: int, reason: Reason) -> None:
        shown, layout = self._shown, self._out.layout
        assert shown is not None
        if status == ANSWER_DONE and layout is not None:
            layout.pack(self.response)
        self._shown, self.xCallerGone = None, False
        if not self._orphan:
            self._put(shown, status, reason)

    def _put(self, info: SlotInfo, status: int, reason: Reason) -> None:
        layout = self._out.layout
        assert layout is not None
        message = layout.view(layout.pack(self.response) if status == ANSWER_DONE else layout.initial())
        words = {"correlation": info.correlation, "client": info.client, "status": status, "reason": reason}
        self._answer, self._ended = partial(self._out.publish, message, **words), info.correlation


class ServiceClient(_ServiceBlock):
    """Calls a service of ROS; the stand-in for a generated ``<pkg>_<Srv>_Client``.

    Call the instance in every scan. A rising edge of ``xExecute`` takes ``request`` over and calls; at most
    one of ``xBusy``, ``xDone``, ``xAborted`` and ``xError`` is set. The end stands while ``xExecute`` is set,
    for one scan at least.

    Args:
        service: The service as ROS writes it.
        client: The use's name in the configuration; empty if it has none.
        request: The compiled-in layout, as a PLC has it; None takes the object's own description.
        response: The same of the response.
        prefix: The bridge's ``prefix:``.
        directory: Where the objects stand.
        beat_ms: The longest time between two calls that this block promises.

    Attributes:
        xExecute: Input: call.
        xAbort: Input: wait no longer; a server that has begun goes on.
        tTimeout: Input: seconds for the whole call; 0: no limit.
        request: Input: what is asked; None before its type is known.
        xBusy: The call is not over.
        xDone: The answer is in ``response``.
        xAborted: Ended by ``xAbort``; ``eOutcome`` tells what became of the call.
        eOutcome: NOT_EXECUTED, FATE_UNKNOWN or UNREADABLE; None while the call has not failed.
        eReason: Why.
        xServer: A server that can be called is known now; no promise.
        response: The answer.
        udiCalls: Calls sent since the start.
        udiLate: Answers that nobody waited for any more.
    """

    def __init__(
        self,
        service: str,
        client: str = "",
        *,
        request: Layout | None = None,
        response: Layout | None = None,
        prefix: str = "rosplc",
        directory: str = "/dev/shm",
        beat_ms: int = 1000,
    ) -> None:
        parts = (Part.RESPONSE, Part.REQUEST)
        super().__init__(service, client, parts, (response, request), prefix, directory, beat_ms)
        self.xExecute = self.xAbort = False
        self.tTimeout = 0.0
        self.request: Any = None if request is None else Message.initial(request)
        self.response: RecordView | None = None
        self.xBusy = self.xDone = self.xAborted = self.xServer = False
        self.eOutcome: ErrorNumber | None = None
        self.eReason = Reason.NONE
        self.udiCalls = self.udiLate = 0
        self._before = False
        self._asked: Any = None  # the request as it was when xExecute rose
        self._since_ns = self._limit_ns = 0
        self._caller: Caller | None = None
        self._object: tuple[Attached, Writer] | None = None  # of the caller

    def __call__(self) -> bool:
        """Run the block once and return ``xDone``.

        Raises:
            LayoutError: LAY006, if a value in ``request`` does not fit its field; nothing is called.
        """
        with self._out._entered() as scan:
            if scan is not None:
                self._run(scan)
        return self.xDone

    def _run(self, scan: Scan) -> None:
        rose, self._before = self.xExecute and not self._before, self.xExecute
        if not self.xBusy and (rose or not self.xExecute):
            self.xDone = self.xAborted = False
            self.eOutcome, self.eReason = None, Reason.NONE
        if rose and not self.xBusy:
            layout = self._out.layout
            self._asked = layout and layout.view(bytes(layout.pack(self.request)))
            self.xBusy, self._since_ns, self._limit_ns = True, scan.now_ns, round(self.tTimeout * 1e9)
        self._look(scan)
        self.xServer = self._in.xPeerAlive and any((self._in.sources, self._out.udiSinks))
        self._follow()
        self._answers()
        if self.xBusy:
            self._decide(scan)
        if self.request is None and self._out.layout is not None:
            self.request = Message.initial(self._out.layout)
        if self.eOutcome is not None and not self.xAborted:
            self.udiError, self.reason = self.eOutcome.value, self.eReason.name

    def _follow(self) -> None:
        """Keep to the object that is open; a call that was sent in another one has ended."""
        found = self._out.open
        if found is None or (self._object is not None and found[1] is self._object[1]):
            return
        if self._sent:
            self._conclude(ErrorNumber.FATE_UNKNOWN, Reason.BRIDGE_RESTARTED)
        self._object, self._caller = found, Caller(*found, follows_claim=False)

    @property
    def _sent(self) -> bool:
        """Whether the call has been sent."""
        return self._caller is not None and bool(self._caller.correlation)

    def _answers(self) -> None:
        info = self._in.take()
        if info is None or self._caller is None:
            return
        status = self._caller.answer(info)
        self.udiLate += not status
        if status == ANSWER_DONE:
            self.response = self._in.msg
            self._conclude(None)
        elif status and not self._caller.correlation:  # ended, and never to be called again
            known = info.reason in list(Reason)
            outcome = _OUTCOMES.get(status, ErrorNumber.FATE_UNKNOWN)
            self._conclude(outcome, Reason(info.reason) if known else Reason.NONE)

    def _decide(self, scan: Scan) -> None:
        over = bool(self._limit_ns) and scan.now_ns - self._since_ns > self._limit_ns
        caller, send = self._caller, partial(self._out.publish, self._asked)
        if self.xAbort or over:
            begun = False
            if caller is not None and caller.correlation:
                begun = True
                with suppress(ChannelError):  # with its object the call has ended as well
                    begun = caller.withdraw(send)
                caller.correlation = 0
            outcome = ErrorNumber.FATE_UNKNOWN if begun else ErrorNumber.NOT_EXECUTED
            self._conclude(outcome, Reason.NONE if self.xAbort else Reason.TIME_OUT)
            self.xAborted = self.xAbort
        elif caller is not None and not caller.correlation and self._may_call(caller):
            with suppress(ChannelError):  # in a later scan
                caller.call(send)
                self.udiCalls += 1

    def _may_call(self, caller: Caller) -> bool:
        if self._asked is None and self._out.layout is not None:
            self._asked = Message.initial(self._out.layout)
        return self.xServer and self.xAttached and self._out.open is not None and caller.claim() != 0

    def _conclude(self, outcome: ErrorNumber | None, reason: Reason = Reason.NONE) -> None:
        self.xBusy, self.xDone = False, outcome is None
        self.eOutcome, self.eReason = outcome, reason
