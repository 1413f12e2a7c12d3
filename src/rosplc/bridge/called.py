"""Services and actions that the PLC calls: for the PLC, the bridge is the answerer."""

from __future__ import annotations

import struct
from abc import abstractmethod
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass
from typing import Any

from rosplc.bridge.port import Context, log
from rosplc.bridge.use import ENDINGS, IDLE_NS, LOOK_NS, Outcome, Use
from rosplc.config.plans import ActionPlan, ServicePlan
from rosplc.errors import RosplcError
from rosplc.reasons import Reason
from rosplc.ros import ActionClient, Backend, GoalEvent, GoalStatus, Reply, ServiceClient, action_classes
from rosplc.shm import Answerer, Part, Reader, SlotInfo
from rosplc.shm import constants as spec
from rosplc.shm.attach import Mapped, start_of
from rosplc.shm.calls import WORDS

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
        """Identifies the run of the PLC's program; 0 while none is running."""
        return self._channels[self._asks].region.word(spec.WRITER_LINE["writer_epoch"])

    # -- the PLC's side

    def turn(self, now_ns: int) -> None:
        """Continue the call."""
        writer, reader, answerer, client = self._writer, self._reader, self._answerer, self._endpoint
        if writer is None or reader is None or answerer is None:
            return
        head, epoch, beat, beat_ms = self._channels[self._asks].region.words(spec.WRITER_LINE["head"], 4)
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
        """Whether the open call is from another run of the PLC's program, whose calls have other numbers."""
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
        """Act on a new call from the PLC."""
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
        """Process the events from the ROS side."""

    # -- beginning and end

    @abstractmethod
    def _give_up(self, reason: Reason, now_ns: int) -> None:
        """Stop waiting for ROS: the call may have been executed."""

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
        """Resume a call that may have begun (0: none); ``lives``: the calling program is still running."""

    def finish(self, now_ns: int) -> None:
        """Detach from the open call."""
        self._let_go(now_ns)


class Called(Asked):
    """A service that the PLC calls."""

    plan: ServicePlan
    _endpoint: ServiceClient | None
    _sent: int | None = None
    """The open call's number in ROS; the number of an earlier call does no harm."""

    def _connect(self, backend: Backend) -> ServiceClient:
        plan = self.plan
        return backend.client(plan.service, plan.type_name, plan.qos)

    def _call(self, payload: bytes, info: SlotInfo) -> None:
        assert self._endpoint is not None
        self._sent = self._endpoint.call(payload, lambda reply: self.tell(info.correlation, reply))

    def _more(self, info: SlotInfo, now_ns: int) -> None:
        if info.status & spec.ASK_WITHDRAWN:
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


_FIRST_PAUSE_NS, _LONGEST_PAUSE_NS = 100_000_000, 5_000_000_000
_MOST_LEFT = 64
"""Maximum number of goals that the PLC no longer waits for and that are still to be canceled."""
_MOST_WAITING = 64
"""Number of queued events up to which overtaken feedback is still passed on."""
_PATIENCE_NS, _UNDECIDED_NS = 2_000_000_000, 600_000_000_000
"""How long the PLC waits for a goal that is unknown to the server, and this bridge to have it canceled.

A server sends its decision only to the bridge that sent the goal; before, the goal is unknown to others.
"""
_ENDS: dict[GoalStatus, tuple[int, Outcome]] = {
    GoalStatus.SUCCEEDED: (spec.ANSWER_SUCCEEDED, "succeeded"),
    GoalStatus.CANCELED: (spec.ANSWER_CANCELED, "canceled"),
    GoalStatus.ABORTED: (spec.ANSWER_ABORTED, "aborted"),
}


@dataclass
class _Goal:
    """A goal of the PLC in ROS."""

    uuid: bytes
    number: int  # its call's correlation
    decided: bool = False  # whether the server has told that it accepts the goal, or will not tell any more
    accepted: bool = False  # whether it is known that the goal was accepted
    said: int = 0  # what the server has said of canceling it: one of the bits of an answer, or 0
    cancel: bool = False  # it is to be canceled, and the server has not been asked, or did not answer
    asked: bool = False  # the server was last asked to cancel it when it was accepted
    lost: bool = False  # status and result are to be asked for
    unknown_ns: int = 0  # since when the server does not know it; 0: it was not asked, or does
    due_ns: int = 0
    pause_ns: int = 0

    def wait(self, now_ns: int) -> None:
        """Schedule the next query to the server, later than the last one."""
        self.pause_ns = min(self.pause_ns * 2 or _FIRST_PAUSE_NS, _LONGEST_PAUSE_NS)
        self.due_ns = now_ns + self.pause_ns


class CalledGoals(Asked):
    """An action to which the PLC sends goals.

    If the PLC no longer waits for a goal that must not continue, the goal is kept until its server has
    answered a request to cancel it: it may be accepted later, or the server may be unreachable.
    """

    plan: ActionPlan
    _endpoint: ActionClient | None

    def __init__(self, plan: ActionPlan, context: Context, on_event: Callable[[Use], None]) -> None:
        super().__init__(plan, context, on_event)
        self._goals: dict[bytes, _Goal] = {}

    def _connect(self, backend: Backend) -> ActionClient:
        plan, store = self.plan, self.plan.goal.store
        return action_classes(store)[1](backend, store, plan.action, plan.type_name, self.tell)

    @property
    def _goal(self) -> _Goal | None:
        """The goal of the open call."""
        return next((goal for goal in self._goals.values() if goal.number == self._open_call), None)

    def turn(self, now_ns: int) -> None:
        """Continue all goals."""
        super().turn(now_ns)
        self._ask(now_ns)
        goal = self._goal
        accepted = "canceling" if goal and goal.said == spec.ANSWER_CANCEL_ACCEPTED else "executing"
        self.goal_status = "" if goal is None else accepted if goal.accepted else "waiting"

    # -- the PLC's side

    def _uuid(self, number: int, asks: Mapped | None = None) -> bytes:
        """Return the UUID of a goal in the current object, or in another one."""
        generation = (asks or self._channels[Part.GOAL]).identity.generation
        return struct.pack("<4I", generation, number >> 32, number & 0xFFFFFFFF, spec.GOAL_ID_END)

    def _deserted(self, epoch: int) -> bool:
        return super()._deserted(epoch) or (self.plan.when_plc_down == "cancel" and self._peer.silent)

    def _call(self, payload: bytes, info: SlotInfo) -> None:
        uuid, now = self._uuid(info.correlation), self._now()
        assert self._endpoint is not None
        if info.client != uuid:
            self._answer("not executed", Reason.REJECTED, now, "the goal's UUID does not match the call")
        elif self._endpoint.send(uuid, payload):
            self._goals[uuid] = _Goal(uuid, info.correlation)
        else:
            self._answer("fate unknown", Reason.NONE, now, "a goal with this UUID has already been sent")

    def _more(self, info: SlotInfo, now_ns: int) -> None:
        goal = self._goal
        if goal is None:
            return
        if info.status & spec.ASK_WITHDRAWN and not goal.accepted:
            self._give_up(Reason.CALLER_GONE, now_ns)
            return
        goal.cancel = bool(info.status & (spec.ASK_CANCEL | spec.ASK_WITHDRAWN))
        if goal.cancel:
            goal.due_ns = 0
        elif goal.said == spec.ANSWER_CANCEL_REJECTED:
            goal.said = 0

    def _report(self, goal: _Goal) -> None:
        """Report the state of the goal to the PLC."""
        if goal.accepted and goal.number == self._open_call:
            status = spec.ANSWER_ACCEPTED | goal.said
            self._send(self._initial, correlation=goal.number, status=status, client=goal.uuid)

    # -- the ROS side

    def _ask(self, now_ns: int) -> None:
        """Send the requests that are due, if the server is available."""
        client = self._endpoint
        if client is None or not client.ready:
            return
        for goal in tuple(self._goals.values()):
            if now_ns < goal.due_ns:
                continue
            try:
                if goal.lost:
                    client.adopt(goal.uuid)
                    goal.lost = False
                if goal.cancel and goal.decided:
                    client.cancel(goal.uuid)
                    goal.asked = goal.accepted
                    goal.cancel = not goal.accepted  # or the server may not know it yet
                    if goal.cancel:
                        goal.wait(now_ns)
            except Exception as error:  # as the backend raises; or no more threads
                goal.wait(now_ns)
                self.note(now_ns, f"the request to the server failed: {error}")

    def _hear(self, now_ns: int) -> None:
        for waiting in range(len(self.events), 0, -1):  # what comes meanwhile waits for the next turn
            (event,) = self.events.popleft()
            overtaken = event.kind == "feedback" and waiting > _MOST_WAITING
            if (goal := self._goals.get(event.uuid)) is not None and not overtaken:
                self._learn(goal, event, now_ns)

    def _learn(self, goal: _Goal, event: GoalEvent, now_ns: int) -> None:
        """Process an event of a goal."""
        reply = event.reply or Reply()
        match event.kind:
            case "accepted":
                goal.decided = goal.accepted = True
                self._report(goal)
            case "rejected":
                self._end(goal, "not executed", Reason.REJECTED, now_ns)
            case "failed":
                self._end(goal, reply.outcome, reply.reason, now_ns, reply.text)
                if reply.outcome == "fate unknown":
                    self._goals[goal.uuid] = goal  # it may be accepted yet
                    self._leave(goal)
            case "feedback":
                self._pass_on(goal, event.payload or b"", now_ns)
            case "status" if event.status and not event.status.ended:
                before = (goal.accepted, goal.said)
                goal.accepted = goal.decided
                if event.status is GoalStatus.CANCELING:
                    goal.said = spec.ANSWER_CANCEL_ACCEPTED
                if before != (goal.accepted, goal.said):
                    goal.due_ns = goal.unknown_ns = 0
                    self._report(goal)
            case "canceling" | "not canceled":
                self._canceling(goal, event.kind == "canceling", reply, now_ns)
            case "result":
                self._result(goal, event, now_ns)
            case "lost":
                if not goal.pause_ns:
                    why = reply.text or WORDS[reply.reason]
                    self.note(now_ns, f"the server returned no result ({why}); requesting it again")
                goal.lost = True
                goal.wait(now_ns)

    def _canceling(self, goal: _Goal, agreed: bool, reply: Reply, now_ns: int) -> None:
        if not agreed and (reply.payload is None or not goal.asked):
            goal.cancel = True
            goal.wait(now_ns)
        elif goal.number != self._open_call:
            self._forget(goal)
        else:
            goal.accepted, goal.cancel, goal.unknown_ns = True, goal.cancel and not agreed, 0
            if goal.said != spec.ANSWER_CANCEL_ACCEPTED:
                goal.said = spec.ANSWER_CANCEL_ACCEPTED if agreed else spec.ANSWER_CANCEL_REJECTED
            self._report(goal)

    def _pass_on(self, goal: _Goal, payload: bytes, now_ns: int) -> None:
        if goal.number != self._open_call:
            return
        record, _, text = self._read(Part.FEEDBACK, payload)
        if text:
            self.note(now_ns, f"feedback was not forwarded to the PLC: {text}", "SHM142")
            return
        self._send(
            record, Part.FEEDBACK, correlation=goal.number, status=spec.ANSWER_ACCEPTED, client=goal.uuid
        )
        self.feedback += 1

    def _result(self, goal: _Goal, event: GoalEvent, now_ns: int) -> None:
        if event.status not in _ENDS:
            self._unknown(goal, now_ns)
            return
        status, outcome = _ENDS[event.status]
        record, reason, text = self._read(Part.RESULT, event.payload or b"")
        if text:
            status, outcome = status | spec.ANSWER_NO_RESULT, "unreadable"
        self._end(goal, outcome, reason, now_ns, text, record, status)

    def _unknown(self, goal: _Goal, now_ns: int) -> None:
        """Note that a goal is unknown to the server: it was forgotten, or is not decided yet."""
        words = "the goal is unknown to the server"
        again, goal.unknown_ns = bool(goal.unknown_ns), goal.unknown_ns or now_ns
        # One answer may be older than the status that has told of the acceptance.
        if (goal.accepted and again) or now_ns - goal.unknown_ns > _UNDECIDED_NS:
            self._end(goal, "fate unknown", Reason.SERVER_GONE, now_ns, words)
            return
        goal.lost = True
        goal.wait(now_ns)
        if goal.number == self._open_call and now_ns - goal.unknown_ns > _PATIENCE_NS:
            self._answer("fate unknown", Reason.BRIDGE_RESTARTED, now_ns, words)
            self._leave(goal)

    def _end(self, goal: _Goal, *answer: Any) -> None:
        """End a goal with an answer as for :meth:`_answer`; the PLC may have to be told later."""
        goal.lost = goal.decided = True
        if goal.number == self._open_call:
            self._answer(*answer)  # or, if that fails, the server is asked for the result once more
        del self._goals[goal.uuid]

    # -- beginning and end

    def _give_up(self, reason: Reason, now_ns: int) -> None:
        goal = self._goal
        self._answer("fate unknown", reason, now_ns)
        if goal is not None:
            self._leave(goal, keep=reason is Reason.PLC_DOWN and self.plan.when_plc_down == "keep")

    def _leave(self, goal: _Goal, *, keep: bool = False) -> None:
        """Have a goal canceled that the PLC no longer waits for."""
        goal.cancel, goal.due_ns = True, 0
        left = [one for one in self._goals.values() if one.number != self._open_call]
        for one in [goal] if keep else left[:-_MOST_LEFT]:
            self._forget(one)

    def _forget(self, goal: _Goal) -> None:
        del self._goals[goal.uuid]
        if self._endpoint is not None:
            self._endpoint.forget(goal.uuid)

    def _unended(self, number: int, lives: bool, channels: Mapping[Part, Mapped]) -> int:
        """Return the number of an earlier bridge's goal that may exist in ROS; 0: there is none."""
        cancels = self.plan.when_plc_down == "cancel"
        if number and (lives or cancels):
            return number
        answered = self._newest(Part.RESULT, channels)
        if answered is None or answered[1].status != spec.ANSWER_FATE_UNKNOWN:
            return 0
        # Given up by the bridge before, which may not have reached the server to cancel it.
        wanted = [Reason.CALLER_GONE, Reason.BRIDGE_RESTARTED] + ([Reason.PLC_DOWN] if cancels else [])
        return answered[1].correlation if answered[1].reason in wanted else 0

    def _found(self, before: Mapping[Part, Mapped]) -> tuple[bytes, int] | None:
        asks, answers = before[Part.GOAL], before[Part.RESULT]
        reader = Reader(asks.region, start_of(asks.region, latched=False, line=0))
        number = Answerer(asks, reader, answers).unanswered
        lives = number >> 32 == asks.region.word(spec.WRITER_LINE["writer_epoch"])
        number = self._unended(number, lives, before)
        return (self._uuid(number, asks), number) if number else None

    def _bereft(self, left: tuple[bytes, int]) -> None:
        """Have a goal of an earlier bridge canceled."""
        uuid, number = left
        goal = self._goals.setdefault(uuid, _Goal(uuid, number, decided=True, lost=True))
        goal.cancel = True
        self.note(self._now(), "canceling a goal that the PLC no longer waits for")

    def _resume(self, number: int, lives: bool, now_ns: int) -> None:
        for goal in tuple(self._goals.values()):
            if goal.number != number and not goal.cancel:
                self._leave(goal)  # it went with its objects
        if not (number := self._unended(number, lives, self._channels)):
            return
        uuid = self._uuid(number)
        if not lives:
            self._bereft((uuid, number))
            return
        goal = self._goals.setdefault(uuid, _Goal(uuid, number, decided=True, lost=True))
        assert self._answerer is not None
        self._answerer.correlation, self._client = number, uuid  # what else comes of it is more
        asked, answered = self._newest(Part.GOAL), self._newest(Part.RESULT)
        status = asked[1].status if asked is not None and asked[1].correlation == number else 0
        goal.cancel = goal.cancel or bool(status & (spec.ASK_CANCEL | spec.ASK_WITHDRAWN))
        if answered is not None and answered[1].correlation == number:
            goal.accepted = goal.accepted or answered[1].status & spec.ANSWER_MASK == spec.ANSWER_ACCEPTED
            goal.said = goal.said or answered[1].status & (
                spec.ANSWER_CANCEL_ACCEPTED | spec.ANSWER_CANCEL_REJECTED
            )
        if status & spec.ASK_WITHDRAWN and not goal.accepted:
            self._give_up(Reason.CALLER_GONE, now_ns)
        self._report(goal)

    def _let_go(self, now_ns: int) -> None:
        """Let the goal continue in ROS, with other objects or with the next bridge."""
        with suppress(RosplcError, OSError, ValueError, AssertionError):
            self._hear(now_ns)

    def give_up(self, now_ns: int) -> None:
        """End the open call and have its goal canceled: no other bridge will find it."""
        self._let_go(now_ns)
        with suppress(RosplcError, OSError, ValueError, AssertionError):
            if self._open_call is not None:
                self._give_up(Reason.BRIDGE_RESTARTED, now_ns)
        for goal in self._goals.values():
            goal.decided = True  # the decision is not waited for
        self._ask(now_ns)
