"""The blocks for services and actions, with which a PLC program calls a ROS server or is a server.

They behave like the generated Structured Text (docs/reference/plc-calls.md); one test suite runs both.
"""

from __future__ import annotations

import struct
import time
from abc import abstractmethod
from collections.abc import Callable, Set
from contextlib import suppress
from functools import partial
from typing import Any, ClassVar

from rosplc.errors import ChannelError
from rosplc.layout import Layout
from rosplc.reasons import Reason
from rosplc.ros.goals import GoalStatus
from rosplc.shm import ACTION, SERVICE, Attached, Caller, Part, Reader, ReaderClaim, SlotInfo, Writer
from rosplc.shm import constants as spec
from rosplc.shm.constants import ErrorNumber
from rosplc.virtual_plc.block import Block, ReadBlock, WriteBlock, _Instance
from rosplc.virtual_plc.task import Scan

_OUTCOMES = {
    spec.ANSWER_NOT_EXECUTED: ErrorNumber.NOT_EXECUTED,
    spec.ANSWER_FATE_UNKNOWN: ErrorNumber.FATE_UNKNOWN,
    spec.ANSWER_UNREADABLE: ErrorNumber.UNREADABLE,
}


def _reason(info: SlotInfo) -> Reason:
    return Reason(info.reason) if info.reason in list(Reason) else Reason.NONE


class _In(ReadBlock):
    """Takes only the newest message of one object, after this block has claimed reader line 0."""

    def __init__(self, part: Part, client: str, name: str, **more: Any) -> None:
        super().__init__(name, stale_after=None, **more)
        self._part, self._client = part, client
        self.xReady = False
        self.fresh = True  # nothing was taken yet since the object was opened

    def look(self, scan: Scan) -> None:
        """Open the object, claim the line, and monitor the bridge."""
        self._run(scan)
        # In place of a silent bridge's object another may just have been opened, for the next scan.
        self.xReady = self.xAttached and self._claim is None and self._opened == self._opened_times
        if self.xAttached and self._claim is not None:
            self.udiError, self.reason = ErrorNumber.CLAIMED.value, "another program holds the object"

    def _adopt(self, attached: Attached, scan: Scan) -> None:
        self.fresh = True
        reader = self._reader = attached.reader()
        claim = attached.region, reader, self._beat_ms, scan.task, range(1)
        self._claim = ReaderClaim(*claim, answer=self._part.asks)

    def _take(self, reader: Reader, scan: Scan) -> bool:
        return False  # take() does

    def take(self) -> SlotInfo | None:
        """Take a new message; ``msg`` is a copy of it."""
        layout, reader = self.layout, self._reader
        if not self.xReady or reader is None or layout is None:
            return None
        try:
            found = reader.latest_record()
        except ChannelError as error:
            self._drop(error)
            self.xReady = False
            return None
        if found is None:
            return None
        self.msg = layout.view(found[0])
        return found[1]

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
        """Identifies the open object; 0: none."""
        return 0 if self._attached is None else self._opened


class _Out(WriteBlock):
    """Writes the messages of one object; ``_leaving`` is called before an object is closed."""

    def __init__(self, part: Part, client: str, leaving: Callable[[], object], *name: Any, **more: Any):
        super().__init__(*name, **more)
        self._part, self._client, self._leaving = part, client, leaving

    @property
    def open(self) -> tuple[Attached, Writer] | None:
        """The object and its writer; None without the claim."""
        attached, writer = self._attached, self._writer
        if attached is None or writer is None or self._opened != self._opened_times:
            return None
        return attached, writer

    def publish(self, message: Any, **words: Any) -> None:
        """Send a message (None: an initial one); ``words`` describe the call in its slot.

        Raises ChannelError if it was not sent.
        """
        found, layout = self.open, self.layout
        if found is None or layout is None:
            raise ChannelError("SHM111", "the object is not open", where=self.topic)
        record = layout.initial() if message is None else layout.pack(message)
        found[1].publish(record, stamp_ns=time.monotonic_ns(), stamp_clock=spec.STAMP_PLC, **words)

    def _detach(self) -> None:
        if self._attached is not None:
            self._leaving()
        super()._detach()


class _CallBlock(_Instance):
    """The common part of all service and action blocks. Call the instance in every scan; it never waits.

    The pins are those of the PLC's block (docs/reference/plc-calls.md), with times in seconds; ``reason`` is
    ``udiError`` as text. ``name`` is the ROS name of the service or action; ``client`` is the client's name
    in the configuration, empty if it has none; ``prefix``, ``directory`` and ``beat_ms`` are as for
    :class:`ReadBlock`. ``layouts`` are the compiled-in layouts by part, ``request=``, ``goal=`` and so on, as
    in a PLC. For an omitted part, the object's own description is used; until the object is open, such an
    input is None.
    """

    _parts: ClassVar[tuple[Part, ...]] = SERVICE
    _calls: ClassVar[bool]
    xAttached = xPeerAlive = False
    udiCalls = 0

    def __init__(
        self,
        name: str,
        client: str = "",
        *,
        prefix: str = "rosplc",
        directory: str = "/dev/shm",
        beat_ms: int = 1000,
        **layouts: Layout | None,
    ) -> None:
        super().__init__()
        if unknown := layouts.keys() - {part.word for part in self._parts}:
            raise TypeError(f"{type(self).__name__} has no part {', '.join(sorted(unknown))}")
        where: Any = {"prefix": prefix, "directory": directory, "beat_ms": beat_ms}
        self._ins: list[_In] = []
        self._outs: list[_Out] = []
        for part in self._parts:
            where["layout"] = layouts.get(part.word)
            if part.asks == self._calls:
                self._outs.append(_Out(part, client, self._leaving, name, **where))
            else:
                self._ins.append(_In(part, client, name, **where))
        self._in, self._out = self._ins[0], self._outs[0]
        self._blocks: list[Block] = [*self._ins, *self._outs]

    def _leaving(self) -> None:
        """Prepare for the closing of the object that the first of ``_outs`` writes."""

    def _report(self, number: int = 0, words: str = "") -> None:
        """Report a problem: of the call if ``number`` is given, otherwise of an object."""
        self.xAttached = self._in.xReady and self._out.xReady
        self.xPeerAlive = self._in.xPeerAlive and self._out.xPeerAlive
        asks: Block = self._out if self._calls else self._in
        wrong = next((one for one in (asks, self._in, self._out, *self._blocks) if one.udiError), None)
        found = (wrong.udiError, wrong.reason) if wrong is not None else (0, "")
        self.udiError, self.reason = (int(number), words) if number else found

    def close(self) -> None:
        """Release the claims and close the objects; the next call opens them again."""
        for block in self._blocks:
            block.close()


def _input(index: int) -> Any:
    """Return the input pin for the message of one of a block's objects; None before its type is known."""
    return property(
        lambda self: self._outs[index].msg, lambda self, value: setattr(self._outs[index], "msg", value)
    )


class _Answerer(_CallBlock):
    """The common part of both servers; ``udiCallers`` is None if unknown, ``age`` is ``tAge`` in seconds."""

    _calls = False
    _steps: ClassVar[tuple[str, ...]]
    xCallerGone = False
    udiCallers: int | None = None
    udiRefused = 0
    age = 0.0
    _before: Set[str] = frozenset()  # inputs that were set
    _now: SlotInfo | None = None  # the message read last
    _found = False  # it waits to be shown or refused
    _verdict = (0, Reason.NONE)  # how it is refused; 0: it is shown
    _shown: SlotInfo | None = None
    _answer: partial[None] | None = None  # to be sent as soon as the object is open
    _orphan = False  # the object of the call that is shown is gone
    _illegal = False
    _object = _since_ns = 0

    def _run(self, scan: Scan) -> bool:
        self._in.look(scan)
        for block in self._outs:
            block._run(scan)
        self._offer(scan)
        now = {step for step in self._steps if getattr(self, step)}
        rose, self._before, self._illegal = now - self._before, now, self._illegal and bool(now)
        self._step(rose)
        with suppress(ChannelError):  # in a later scan
            if self._answer is not None:
                self._answer()
            self._answer = None
        self.udiCallers = self._in.udiSources
        self.age = (scan.now_ns - self._since_ns) / 1e9 if self._shown is not None else 0.0
        self._report(ErrorNumber.ILLEGAL_STEP * self._illegal, "the current call does not allow this step")
        return self._shown is not None

    def _offer(self, scan: Scan) -> None:
        """Check the newest message, and present the call if it may begin."""
        if self._in.xReady and self._in.object != self._object:
            # The bridge has ended what the object before held.
            self._object, self._found, self._answer = self._in.object, False, None
            self._orphan = self.xCallerGone = self._shown is not None
        elif self._in.udiError in (ErrorNumber.RETIRED, ErrorNumber.NO_OBJECT):  # no bridge finds it again
            self.xCallerGone = self._shown is not None
        info, now, shown = self._in.take(), self._now, self._shown
        if info is not None:
            fresh, self._in.fresh = self._in.fresh, False
            again = now is not None and info.correlation == now.correlation
            if self._found and not again and self._answer is None:
                self._put(now, spec.ANSWER_NOT_EXECUTED, Reason.CALLER_GONE)
                self._found, self.udiRefused = False, self.udiRefused + 1
            if shown is not None and not self._orphan and info.correlation == shown.correlation:
                self._updated(info.status)
                self._found = False
            else:
                self._found = self._found or not again  # one that has ended is not begun again
                self.xCallerGone = self.xCallerGone or (shown is not None and self._found)
            self._now, self._verdict = info, (0, Reason.NONE)
            if info.status != spec.ASK_CALL and fresh:  # an earlier program may have begun it
                self._verdict = spec.ANSWER_FATE_UNKNOWN, Reason.PLC_DOWN
            elif info.status != spec.ASK_CALL:
                self._verdict = spec.ANSWER_NOT_EXECUTED, Reason.CALLER_GONE
        if self._found and self._verdict[0] and self._answer is None:
            self._put(self._now, *self._verdict)
            self._found, self.udiRefused = False, self.udiRefused + 1
        free = self._shown is None and self._answer is None and self._out.xReady
        if self._found and free and self._in.begin():
            self._begin(scan)

    def _begin(self, scan: Scan) -> None:
        self._shown, self._found = self._now, False
        setattr(self, self._in._part.word, self._in.msg)
        self._since_ns, self.xCallerGone, self._orphan = scan.now_ns, False, False
        self.udiCalls += 1

    def _updated(self, status: int) -> None:
        """Process a further message of the current call; each message repeats all requests."""
        self.xCallerGone = self.xCallerGone or bool(status & spec.ASK_WITHDRAWN)

    @abstractmethod
    def _step(self, rose: set[str]) -> None:
        """Execute the steps for the inputs with a rising edge."""

    def _end(self, status: int, reason: Reason = Reason.NONE, answer: Any = None) -> None:
        """End the current call, with ``answer`` as the record if it fits."""
        if not self._orphan:
            self._put(self._shown, status, reason, answer)
        self._shown, self.xCallerGone = None, False

    def _put(
        self, info: SlotInfo | None, status: int, reason: Reason = Reason.NONE, answer: Any = None
    ) -> None:
        layout = self._out.layout
        assert info is not None
        if answer is not None and layout is not None:
            answer = layout.view(bytes(layout.pack(answer)))
        words = {"correlation": info.correlation, "client": info.client, "status": status, "reason": reason}
        self._answer = partial(self._out.publish, answer, **words)


class ServiceServer(_Answerer):
    """A server for a service that ROS calls; simulates a generated ``<pkg>_<Srv>_Server``.

    While ``xRequest`` is set, execute ``request``; a rising edge of ``xReply`` sends ``response``, a rising
    edge of ``xReject`` refuses the call.
    """

    _steps = ("xReply", "xReject")
    xReply = xReject = xRequest = False
    request: Any = None
    response = _input(0)

    def _step(self, rose: set[str]) -> None:
        if rose:
            # Shown before this call, and one answer, not two.
            self._illegal = not self.xRequest or (self.xReply and self.xReject)
            if not self._illegal and self.xReply:
                self._end(spec.ANSWER_DONE, answer=self.response)
            elif not self._illegal:
                self._end(spec.ANSWER_NOT_EXECUTED, Reason.REJECTED)
        self.xRequest = self._shown is not None


class ActionServer(_Answerer):
    """A server for goals from ROS, one at a time; simulates a generated ``<pkg>_<Act>_ActionServer``.

    While ``xGoal`` is set, accept or reject ``goal``. A rising edge of ``xSucceed``, ``xAbort`` or
    ``xCanceled`` ends an accepted goal with ``result``. A step that the current goal does not allow has no
    effect and is reported (ILLEGAL_STEP).
    """

    _parts = ACTION
    _ends: ClassVar[dict[str, int]] = {
        "xSucceed": spec.ANSWER_SUCCEEDED,
        "xAbort": spec.ANSWER_ABORTED,
        "xCanceled": spec.ANSWER_CANCELED,
    }
    _steps = ("xAccept", "xReject", "xAcceptCancel", "xRejectCancel", *_ends)
    xAccept = xReject = xSendFeedback = xAcceptCancel = xRejectCancel = False
    xSucceed = xAbort = xCanceled = False
    xGoal = xActive = xCancelRequested = xCanceling = xPreempt = False
    goal: Any = None
    result, feedback = _input(0), _input(1)
    _accepted = _asked = False
    _cancel = 0  # what was decided on the request to cancel
    _status = 0  # of the newest message

    def _run(self, scan: Scan) -> bool:
        in_hand = super()._run(scan)
        goal = self._shown
        if self.xSendFeedback and self.xActive and goal is not None and not self._orphan:
            words = {"correlation": goal.correlation, "client": goal.client, "status": spec.ANSWER_ACCEPTED}
            with suppress(ChannelError):  # the newest counts
                self._outs[1].publish(self.feedback, **words)
        return in_hand

    def _begin(self, scan: Scan) -> None:
        super()._begin(scan)
        self._accepted = self._asked = self.xCanceling = self.xPreempt = False
        self._cancel, self._status = 0, spec.ASK_CALL

    def _updated(self, status: int) -> None:
        super()._updated(status)
        if not status & spec.ASK_CANCEL:
            self._asked = False
        elif not self.xCanceling and (not self._status & spec.ASK_CANCEL or status == self._status):
            self._asked = True  # for the first time, or again
        self.xPreempt, self._status = bool(status & spec.ASK_PREEMPT), status

    def _step(self, rose: set[str]) -> None:
        if self._shown is not None and self.xCallerGone and not self._accepted:
            self._end(spec.ANSWER_NOT_EXECUTED, Reason.CALLER_GONE)  # nobody has begun it
        # Each step belongs to what the pins showed before this call.
        decided, canceled, ended = (
            rose.intersection(steps) for steps in (self._steps[:2], self._steps[2:4], self._ends)
        )
        allowed = (self.xGoal and self._shown is not None, self.xCancelRequested, self.xActive)
        for steps, possible in zip((decided, canceled, ended), allowed, strict=True):
            if steps and (len(steps) > 1 or not possible):
                self._illegal = True
                steps.clear()
        if "xAccept" in decided:
            self._accepted = True
            self._put(self._shown, spec.ANSWER_ACCEPTED)
        elif decided:
            self._end(spec.ANSWER_NOT_EXECUTED, Reason.REJECTED)
        if canceled:
            self._asked, self.xCanceling = False, "xAcceptCancel" in canceled
            self._cancel = spec.ANSWER_CANCEL_ACCEPTED if self.xCanceling else spec.ANSWER_CANCEL_REJECTED
            if not self._orphan:
                self._put(self._shown, spec.ANSWER_ACCEPTED | self._cancel)
        if ended == {"xCanceled"} and not self.xCanceling:
            self._illegal = True
        elif ended:
            self._end(self._ends[ended.pop()] | self._cancel, answer=self.result)
        in_hand = self._shown is not None
        self.xGoal, self.xActive = in_hand and not self._accepted, in_hand and self._accepted
        self.xCancelRequested = self.xActive and self._asked
        self.xCanceling = self.xActive and self.xCanceling
        self.xPreempt = in_hand and self.xPreempt


class _Caller(_CallBlock):
    """Common part of both clients: at most one of ``xBusy``, ``xDone``, ``xAborted``, ``xError`` is set."""

    _calls = True
    _stop: ClassVar[str]  # the input that asks for the end of the call
    xExecute = False
    tTimeout = tBridgeGrace = 0.0
    xBusy = xDone = xAborted = xServer = False
    eReason = Reason.NONE
    udiLate = 0
    _before = False
    _outcome: ErrorNumber | None = None
    _asked: Any = None  # what is asked, as it was when xExecute rose
    _since_ns = _limit_ns = _grace_ns = 0
    _silent_ns = 0  # since when the bridge is silent; 0: it is not
    _sent = False  # the call in hand has been sent; one that was given up may be open besides
    _stopped = False  # the program has asked for its end
    _caller: Caller | None = None
    _object: tuple[Attached, Writer] | None = None  # of the caller

    @property
    def xError(self) -> bool:
        """Whether the call has failed."""
        return self._outcome is not None and not self.xAborted

    def _run(self, scan: Scan) -> bool:
        self._start(scan)
        for block in self._ins:
            block.look(scan)
        self._hear()
        self._out._run(scan)
        self._follow()
        known = self._in.udiSources, self._out.udiSinks
        alive = self._in.xPeerAlive and self._out.xPeerAlive
        self.xServer = alive and any(known)
        ready = alive and self._in.xReady and (self.xServer or None in known)
        self._silent_ns = 0 if alive else self._silent_ns or scan.now_ns
        if self.xBusy:
            over = bool(self._limit_ns) and scan.now_ns - self._since_ns > self._limit_ns
            if self._grace_ns and self._silent_ns:
                over |= scan.now_ns - max(self._silent_ns, self._since_ns) > self._grace_ns
            if self._sent and self._caller is not None:
                self._pursue(self._caller, over)
            else:
                self._open(over, ready)
        self._report(self._outcome or 0, self.eReason.name)
        return self.xDone

    def _start(self, scan: Scan) -> None:
        rose, self._before = self.xExecute and not self._before, self.xExecute
        if self.xBusy:
            return
        if rose or not self.xExecute:
            self.xDone = self.xAborted = False
            self._outcome, self.eReason = None, Reason.NONE
        if rose:
            layout = self._out.layout
            self._asked = layout and layout.view(bytes(layout.pack(self._out.msg)))
            self.xBusy, self._since_ns, self._limit_ns = True, scan.now_ns, round(self.tTimeout * 1e9)
            self._grace_ns = round(self.tBridgeGrace * 1e9)
            self._sent = self._stopped = False

    def _hear(self) -> None:
        info = self._in.take()
        if info is None:
            return
        status = self._caller.answer(info) if self._caller is not None else 0
        if status and self._sent:
            self._answered(info, status)
        else:
            self.udiLate += 1

    @abstractmethod
    def _answered(self, info: SlotInfo, status: int) -> None:
        """Process an answer to the current call."""

    def _failed(self, info: SlotInfo, status: int) -> None:
        """End the call with an answer without a record; ignore answers to other kinds of calls."""
        if self._caller is not None and self._caller.correlation:
            return  # no answer that ends a call
        outcome = _OUTCOMES.get(status, ErrorNumber.FATE_UNKNOWN)
        stopped = self._stopped and status == spec.ANSWER_NOT_EXECUTED
        self._conclude(outcome, _reason(info), stopped=stopped)

    def _follow(self) -> None:
        """Follow the open object; a call that was sent in another object has ended."""
        found = self._out.open
        if found is None or (self._object is not None and found[1] is self._object[1]):
            return
        if self._sent:
            self._conclude(ErrorNumber.FATE_UNKNOWN, Reason.BRIDGE_RESTARTED, stopped=self._stopped)
        self._object, self._caller = found, Caller(*found, follows_claim=False)

    def _leaving(self) -> None:
        """Check a retired object, and the call in it, for the last time."""
        fate = self._caller.retired() if self._caller is not None else 0
        if fate and self._sent:
            self._conclude(_OUTCOMES[fate], Reason.BRIDGE_RESTARTED, stopped=self._stopped)

    def _open(self, over: bool, ready: bool) -> None:
        """Send the current call, or end it."""
        caller = self._caller
        if getattr(self, self._stop):
            self._conclude(ErrorNumber.NOT_EXECUTED, stopped=True)
        elif over:
            self._conclude(ErrorNumber.NOT_EXECUTED, Reason.TIME_OUT)
        elif ready and caller is not None and not caller.correlation and self._out.open and caller.claim():
            with suppress(ChannelError):  # in a later scan
                caller.call(self._send)
                self._sent = True
                self.udiCalls += 1

    @abstractmethod
    def _pursue(self, caller: Caller, over: bool) -> None:
        """Continue a call that was sent."""

    def _send(self, **words: Any) -> None:
        self._out.publish(self._asked, **words)

    def _conclude(
        self, outcome: ErrorNumber | None, reason: Reason = Reason.NONE, *, stopped: bool = False
    ) -> None:
        self.xBusy = self._sent = False
        self.xDone, self.xAborted = outcome is None, stopped and outcome is not None
        self._outcome, self.eReason = outcome, reason

    def close(self) -> None:
        """Close the block; the outcome of a current call is unknown."""
        if self._caller is not None:
            self._caller.correlation = 0
        if self._sent:
            self._conclude(ErrorNumber.FATE_UNKNOWN, Reason.PLC_DOWN)
        super().close()


class ServiceClient(_Caller):
    """Calls a ROS service; simulates a generated ``<pkg>_<Srv>_Client``."""

    _stop = "xAbort"
    xAbort = False
    request = _input(0)
    response: Any = None

    def _answered(self, info: SlotInfo, status: int) -> None:
        if status == spec.ANSWER_DONE:
            self.response = self._in.msg
            self._conclude(None)
        else:
            self._failed(info, status)

    def _pursue(self, caller: Caller, over: bool) -> None:
        if self.xAbort or over:
            begun = True
            with suppress(ChannelError):  # with its object the call has ended as well
                begun = caller.withdraw(self._send)
            caller.correlation = 0
            outcome = ErrorNumber.FATE_UNKNOWN if begun else ErrorNumber.NOT_EXECUTED
            why = Reason.NONE if self.xAbort else Reason.TIME_OUT
            self._conclude(outcome, why, stopped=self.xAbort)


class ActionClient(_Caller):
    """Sends goals to a ROS action; simulates a generated ``<pkg>_<Act>_ActionClient``."""

    _parts = ACTION
    _stop = "xCancel"
    xCancel = xActive = xCancelRejected = xNewFeedback = False
    eStatus = GoalStatus.UNKNOWN
    goal = _input(0)
    result: Any = None
    feedback: Any = None
    _accepted = _cancels = False
    _ENDS: ClassVar[dict[int, tuple[GoalStatus, ErrorNumber | None]]] = {
        spec.ANSWER_SUCCEEDED: (GoalStatus.SUCCEEDED, None),
        spec.ANSWER_CANCELED: (GoalStatus.CANCELED, ErrorNumber.GOAL_CANCELED),
        spec.ANSWER_ABORTED: (GoalStatus.ABORTED, ErrorNumber.GOAL_ABORTED),
    }

    def _run(self, scan: Scan) -> bool:
        done = super()._run(scan)
        self.xActive = self.xBusy and self._accepted
        return done

    def _start(self, scan: Scan) -> None:
        was_busy = self.xBusy
        super()._start(scan)
        if self.xBusy and not was_busy:
            self._accepted = self._cancels = self.xCancelRejected = False
            self.eStatus = GoalStatus.UNKNOWN

    def _hear(self) -> None:
        news, known = self._ins[1].take(), self._caller.correlation if self._sent and self._caller else 0
        self.xNewFeedback = news is not None and news.correlation == known != 0
        if self.xNewFeedback:
            self.feedback = self._ins[1].msg
        super()._hear()

    def _answered(self, info: SlotInfo, status: int) -> None:
        if status == spec.ANSWER_ACCEPTED:
            self._accepted = True
            agreed = info.status & spec.ANSWER_CANCEL_ACCEPTED
            self.eStatus = GoalStatus.CANCELING if agreed else GoalStatus.EXECUTING
            if not agreed:
                self.xCancelRejected = self._cancels and bool(info.status & spec.ANSWER_CANCEL_REJECTED)
        elif status in self._ENDS:
            self.eStatus, outcome = self._ENDS[status]
            why = _reason(info)
            if not info.status & spec.ANSWER_NO_RESULT:
                self.result = self._in.msg
            elif outcome is None:
                outcome, why = ErrorNumber.UNREADABLE, Reason.TOO_LARGE
            self._conclude(outcome, why, stopped=status == spec.ANSWER_CANCELED)
        else:
            self._failed(info, status)

    def _pursue(self, caller: Caller, over: bool) -> None:
        if over:  # one that has not begun never will (M26)
            begun, withdrawn = True, 0 if self._accepted else spec.ASK_WITHDRAWN
            with suppress(ChannelError):  # with its object the goal has ended as well
                caller.again(self._send, spec.ASK_CANCEL | withdrawn)
                begun = self._accepted or caller.begun()
            if not begun:
                caller.correlation = 0
            outcome = ErrorNumber.FATE_UNKNOWN if begun else ErrorNumber.NOT_EXECUTED
            self._conclude(outcome, Reason.TIME_OUT)
        elif self.xCancel != self._cancels and (self.xCancel or self.xCancelRejected):
            with suppress(ChannelError):  # in a later scan
                caller.again(self._send, spec.ASK_CANCEL if self.xCancel else 0)
                self._cancels = self._stopped = self.xCancel
                self.xCancelRejected = False

    def _send(self, **words: Any) -> None:
        """Send the goal with its UUID, which is derived from words in its slot."""
        number = words["correlation"]
        assert self._object is not None
        uuid = self._object[0].region.generation, number >> 32, number & 0xFFFFFFFF, spec.GOAL_ID_END
        super()._send(**{**words, "client": struct.pack("<4I", *uuid)})
