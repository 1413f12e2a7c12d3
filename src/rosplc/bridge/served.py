"""Services and actions that the PLC serves: for the PLC, the bridge is the caller."""

from __future__ import annotations

from abc import abstractmethod
from collections import Counter, deque
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass
from functools import partial

from rosplc.bridge.port import Context
from rosplc.bridge.use import ENDINGS, IDLE_NS, LOOK_NS, Outcome, Use
from rosplc.config.plans import ActionPlan, ServicePlan
from rosplc.errors import ChannelError, RosplcError
from rosplc.reasons import Reason
from rosplc.ros import ActionServer, Backend, GoalStatus, ServiceServer, action_classes
from rosplc.shm import Caller, GoalNotes, Part, SlotInfo
from rosplc.shm import constants as spec
from rosplc.shm.attach import Mapped, start_of
from rosplc.shm.calls import WORDS

_PATIENCE_NS = 10_000_000_000
"""How long the answer to an earlier bridge's call waits until the middleware has found the caller again."""
_REMEMBERED = 256
"""Number of recent callers that are remembered, because their requests may arrive twice."""
_CLIENT = 8
"""Bytes of a caller's identification that are the same in all its calls."""


@dataclass(eq=False)
class _Call:
    """A call from ROS to the PLC."""

    caller: bytes  # as the ROS side knows it
    record: bytes  # the request
    arrived_ns: int  # when it came
    withdrawn: bool = False  # whether the PLC was told that nobody waits
    ended: bool = False  # whether the caller has been told how it ended, though the PLC has not ended it
    inherited: bool = False  # it was handed out by an earlier bridge, and begun


class Calling(Use):
    """A service or action that the PLC serves: for the PLC, the bridge is the caller."""

    _caller: Caller | None = None
    _again = False  # the newest answer counts once more: it is to what an earlier bridge asked

    @property
    def _down(self) -> bool:
        """Whether the PLC's block is known to be gone, or there are no objects."""
        return self._writer is None or not self._holder or self._peer.silent

    def _take_answers(self, now_ns: int) -> None:
        """Forward the newest answer, and only then store that it was taken."""
        answers = self.plan.parts[1]
        reader, plan = self._readers[answers], self._codecs[answers].plan
        again, self._again = self._again, False
        found = reader.peek_wire(plan)
        if found is None or (found[1].sequence == reader.last and not again):
            return
        self._answered(*found, now_ns)
        taken = reader.latest_wire(plan)
        if taken is not None and taken[1].sequence != found[1].sequence:
            self._answered(*taken, now_ns)

    @abstractmethod
    def _answered(self, payload: bytes, info: SlotInfo, now_ns: int) -> None:
        """Act on an answer."""

    def _check_claims(self) -> None:
        """Raise ChannelError (SHM116) if this bridge no longer owns the answers."""
        if any(reader.line is None for reader in self._readers.values()):
            what = f"another bridge has taken over the {self.plan.kind}"
            raise ChannelError("SHM116", what, where=self.plan.called)


class Served(Calling):
    """A service that the PLC serves."""

    plan: ServicePlan
    _endpoint: ServiceServer | None

    def __init__(self, plan: ServicePlan, context: Context, on_event: Callable[[Use], None]) -> None:
        super().__init__(plan, context, on_event)
        self._waiting: deque[_Call] = deque()
        self._open_call: _Call | None = None
        self._unsent: deque[tuple[bytes, bytes | None, Outcome, Reason, int]] = deque()
        self._recent: deque[bytes] = deque(maxlen=_REMEMBERED)
        self._next_ns = 0  # before that the rate limit lets nothing pass
        codec = self._codecs[Part.RESPONSE]
        self._fallback = None if plan.fallback is None else codec.encode(plan.fallback)

    def _connect(self, backend: Backend) -> ServiceServer:
        plan = self.plan
        return backend.serve(plan.service, plan.type_name, plan.qos, self.tell)

    @property
    def _outstanding(self) -> int:
        call = self._open_call
        return (
            len(self._waiting) + len(self.events) + len(self._unsent) + (call is not None and not call.ended)
        )

    # -- a call's beginning and end

    def turn(self, now_ns: int) -> None:
        """Continue all calls."""
        try:
            if self._writer is not None:
                self._look(now_ns)
        finally:
            self._receive(now_ns)
        self._hand_out(now_ns)
        self._repeat(now_ns)
        busy = self._open_call is not None or self._waiting or self._unsent
        self.due_ns = now_ns + (LOOK_NS if busy else IDLE_NS)
        if self._waiting and self._open_call is None and now_ns < self._next_ns:
            self.due_ns = min(self.due_ns, self._next_ns)

    def _receive(self, now_ns: int) -> None:
        """Queue the requests that have arrived, or refuse them."""
        plan = self.plan
        for _ in range(len(self.events)):  # what comes meanwhile waits for the next turn
            payload, caller, _ = self.events.popleft()
            if caller in self._recent:
                continue
            self.received += 1
            call = _Call(caller, b"", now_ns)
            known = [one for one in (*self._waiting, self._open_call) if one is not None and not one.ended]
            # Only who knows callers by what they have themselves can tell clients apart.
            told = self._endpoint is not None and self._endpoint.remembers
            same = sum(told and one.caller[:_CLIENT] == caller[:_CLIENT] for one in known)
            self._recent.append(caller)
            call.record, reason, text = self._read(Part.REQUEST, payload)
            if text:
                self._end(call, "not executed", reason or Reason.REJECTED, now_ns, text)
            elif self._down:
                self._end(call, "not executed", Reason.PLC_DOWN, now_ns)
            elif len(known) >= plan.depth or same >= plan.per_client:
                self._end(call, "not executed", Reason.QUEUE_FULL, now_ns)
            else:
                self._waiting.append(call)

    def _hand_out(self, now_ns: int) -> None:
        while self._waiting:
            call = self._waiting[0]
            if self._down:
                self._end(self._waiting.popleft(), "not executed", Reason.PLC_DOWN, now_ns)
            elif now_ns - call.arrived_ns > self.plan.expire_after_ns:
                self._end(self._waiting.popleft(), "not executed", Reason.EXPIRED, now_ns)
            elif self._open_call is not None or now_ns < self._next_ns or not self._peer.alive:
                return
            elif not self._present(call):
                self._end(self._waiting.popleft(), "not executed", Reason.CALLER_GONE, now_ns)
            else:
                self._publish(call, now_ns)

    def _publish(self, call: _Call, now_ns: int) -> None:
        """Hand out the call that has waited longest; if this fails, it keeps waiting."""
        assert self._caller is not None
        self._caller.call(partial(self._send, call.record), client=call.caller)
        self._open_call = self._waiting.popleft()
        self._next_ns = now_ns + self.plan.min_interval_ns

    def _withdraw(self, call: _Call) -> bool:
        """Tell the PLC that the caller no longer waits; return whether the call may have begun (M26)."""
        assert self._caller is not None
        if call.withdrawn:
            return True  # or it would have ended with that
        begun = self._caller.withdraw(partial(self._send, call.record))
        call.withdrawn = True  # only now: what could not be withdrawn may still begin
        return begun or call.inherited

    def _end(self, call: _Call, outcome: Outcome, reason: Reason, now_ns: int, text: str = "") -> None:
        """Count a call without an answer, and send the caller the configured response, if any."""
        if call is self._open_call:
            self._open_call = None
        if call.ended:
            return
        call.ended = True
        if call.inherited:
            self._unsent.append((call.caller, self._fallback, outcome, reason, now_ns + _PATIENCE_NS))
            return
        self._count(outcome, reason, now_ns, text)
        self._reply(call.caller, self._fallback, text or WORDS[reason])

    def _reply(self, caller: bytes, payload: bytes | None, text: str) -> bool:
        server = self._endpoint
        if server is None:
            return False
        try:
            return server.refuse(caller, text) if payload is None else server.reply(caller, payload)
        except RosplcError as error:
            self.note(self._now(), f"answer not sent: {error.what}", error.code)
            return False

    def _present(self, call: _Call) -> bool:
        return self._endpoint is None or self._endpoint.present(call.caller)

    # -- the open call

    def _look(self, now_ns: int) -> None:
        """Check the PLC's side and the state of the open call."""
        claim, beat, beat_ms, taken = self._channels[Part.REQUEST].region.words(spec.reader_line(0), 4)
        self._observe(claim, beat, taken, beat_ms, now_ns)
        self._take_answers(now_ns)
        call, caller = self._open_call, self._caller
        if call is None or caller is None:
            return
        if outcome := caller.lost(partial(self._send, call.record)):
            lost = "fate unknown" if call.inherited else ENDINGS[outcome]
            self._end(call, lost, Reason.PLC_DOWN, now_ns)
        elif not call.ended:
            self._judge(call, caller.begun(), now_ns)

    def _judge(self, call: _Call, begun: bool, now_ns: int) -> None:
        """Withdraw a call whose caller no longer waits, or that will not be executed."""
        waited = now_ns - call.arrived_ns
        if self._peer.silent:
            if self._withdraw(call):
                # The object stays taken until the PLC speaks again; the caller is told now.
                self._end(call, "fate unknown", Reason.PLC_DOWN, now_ns)
                self._open_call = call
            else:
                self._end(call, "not executed", Reason.PLC_DOWN, now_ns)
        elif call.withdrawn:
            return
        elif call.inherited:
            if waited > _PATIENCE_NS:
                self._withdraw(call)
        elif not begun and waited > self.plan.expire_after_ns:
            if not self._withdraw(call):
                self._end(call, "not executed", Reason.EXPIRED, now_ns)
        elif not self._present(call) and not self._withdraw(call):
            self._end(call, "not executed", Reason.CALLER_GONE, now_ns)

    def _answered(self, payload: bytes, info: SlotInfo, now_ns: int) -> None:
        call = self._open_call
        answer = 0 if self._caller is None else self._caller.answer(info)
        if call is None or not answer or (self._caller is not None and self._caller.correlation):
            self.strays += 1  # another call's, or none that ends a call
            return
        self._check_claims()
        outcome = ENDINGS.get(answer, "fate unknown")
        if outcome != "done":
            reason = Reason(info.reason) if info.reason in list(Reason) else Reason.NONE
            if outcome == "not executed" and call.inherited and call.withdrawn:
                # Another life of the PLC's block may have begun what this one found withdrawn.
                outcome, reason = "fate unknown", Reason.BRIDGE_RESTARTED
            self._end(call, outcome, reason, now_ns)
            return
        self._open_call = None
        if call.ended:
            self.strays += 1
        elif call.inherited:
            self._unsent.append((call.caller, payload, "done", Reason.NONE, now_ns + _PATIENCE_NS))
        else:
            sent = self._reply(call.caller, payload, "")
            self._count("done" if sent else "late", Reason.NONE, now_ns)

    # -- calls of an earlier bridge

    def _claimed(self) -> None:
        reader = self._readers[Part.RESPONSE]
        asks, writer = self._channels[Part.REQUEST], self._writers[Part.REQUEST]
        self._caller = Caller(asks, writer, follows_claim=True)
        found, answer = self._newest(Part.REQUEST), self._newest(Part.RESPONSE)
        if self._known or found is None or not found[1].status & spec.ASK_CALL:
            return
        (record, info), now = found, self._now()
        answered = answer is not None and answer[1].correlation == info.correlation
        if answered and answer is not None and answer[1].sequence == reader.last:
            return  # it was passed on
        self._caller.resume(info)
        call = self._open_call = _Call(info.client, record, now)
        self.received += 1
        self._recent.append(call.caller)
        # The program that answered what it found withdrawn may not be the one that had begun it.
        call.withdrawn = bool(answered and info.status & spec.ASK_WITHDRAWN)
        call.inherited = answered or self._caller.begun() or self._withdraw(call)
        if not call.inherited:
            self._open_call, call.ended = None, True
            reason = Reason.BRIDGE_RESTARTED
            self._unsent.append((call.caller, self._fallback, "not executed", reason, now + _PATIENCE_NS))
        elif info.status & spec.ASK_WITHDRAWN and not answered:
            # Said again: a program that started in between has seen neither the call nor this.
            self._withdraw(call)

    def _repeat(self, now_ns: int, *, last: bool = False) -> None:
        """Answer an earlier bridge's callers when the middleware has found them; ``last``: now or never."""
        server = self._endpoint
        if server is None:
            return
        for _ in range(len(self._unsent)):
            caller, payload, outcome, reason, until_ns = self._unsent.popleft()
            if payload is None or not server.remembers:
                if outcome == "done":
                    outcome, reason = "fate unknown", Reason.BRIDGE_RESTARTED
                self._reply(caller, None, WORDS[reason])
            elif not self._reply(caller, payload, ""):
                if now_ns < until_ns and not last:
                    self._unsent.append((caller, payload, outcome, reason, until_ns))
                    continue
                outcome = "late" if outcome == "done" else outcome
            self._count(outcome, reason, now_ns)

    # -- leaving

    def _let_go(self, now_ns: int) -> None:
        begun = True
        with suppress(RosplcError, OSError, ValueError, AssertionError):
            self._take_answers(now_ns)
        if (call := self._open_call) is None:
            return
        with suppress(RosplcError, OSError, ValueError, AssertionError):
            begun = self._withdraw(call)
        if begun:
            self._end(call, "fate unknown", Reason.BRIDGE_RESTARTED, now_ns)
            return
        # It goes to the next objects.
        self._open_call, call.withdrawn = None, False
        self._waiting.appendleft(call)

    def finish(self, now_ns: int) -> None:
        """Refuse waiting calls; a call that the PLC has begun is left to the next bridge."""
        with suppress(RosplcError, ValueError, OSError):
            self._receive(now_ns)
        while self._waiting:
            self._end(self._waiting.popleft(), "not executed", Reason.BRIDGE_RESTARTED, now_ns)
        call, caller = self._open_call, self._caller
        if call is not None and caller is not None and not call.inherited:
            with suppress(RosplcError, ValueError, OSError):
                if not caller.begun() and not self._withdraw(call):
                    self._end(call, "not executed", Reason.BRIDGE_RESTARTED, now_ns)
        self._repeat(now_ns, last=True)


_GONE = "the objects of the goal are no longer in use"
_TICK_NS = 1_000_000_000
_ENDS: dict[int, Outcome] = {
    spec.ANSWER_NOT_EXECUTED: "not executed",
    spec.ANSWER_FATE_UNKNOWN: "fate unknown",
}
_OF_ACCEPTED = (spec.ANSWER_ACCEPTED, spec.ANSWER_SUCCEEDED, spec.ANSWER_CANCELED, spec.ANSWER_ABORTED)


@dataclass(eq=False)
class _Goal:
    """A goal from ROS."""

    uuid: bytes
    record: bytes
    stamp_ns: int = 0  # when it was handed out, in ns since 1970
    number: int = 0  # its correlation
    handed_ns: int = 0  # when it was handed out, on the monotonic clock
    asked: int = spec.ASK_ACCEPTED  # what the PLC was asked last besides, once it has accepted
    cancel: bool = False  # a request to cancel that the PLC has not been told of
    accepted: bool = False
    withdrawn: bool = False  # the PLC was told that nobody waits for its decision
    unwanted: bool = False  # its client has taken it back before the decision
    inherited: bool = False  # it was handed out by an earlier bridge
    note: bytes = b""  # what the next bridge has to know to adopt it


class ServedGoals(Calling):
    """An action that the PLC serves.

    A goal stays undecided in ROS until the PLC has accepted or rejected it. Only the PLC's newest answer is
    read: each answer implies the earlier ones.
    """

    plan: ActionPlan
    _endpoint: ActionServer | None

    def __init__(self, plan: ActionPlan, context: Context, on_event: Callable[[Use], None]) -> None:
        super().__init__(plan, context, on_event)
        self._waiting: deque[_Goal] = deque()
        self._notes: GoalNotes | None = None
        self._open_goal: _Goal | None = None
        self._taken = 0  # the sequence that the PLC's block took last
        self._refused: Counter[Reason] = Counter()  # goals that the endpoint has rejected, and are counted
        self._tick_ns = 0

    def _connect(self, backend: Backend) -> ActionServer:
        plan, store, goal = self.plan, self.plan.goal.store, self._open_goal
        server, _ = action_classes(store)
        self._refused.clear()
        return server(
            backend,
            store,
            plan.action,
            plan.type_name,
            on_goal=partial(self.tell, "goal"),
            on_cancel=partial(self.tell, "cancel"),
            keep_result_ns=plan.keep_result_ns,
            # Not later: a client that asks for the result would be told that the goal is not known.
            executing=[(goal.uuid, goal.stamp_ns, goal.note)] if goal and goal.accepted else [],
            clock=self.context.clock,
        )

    @property
    def _outstanding(self) -> int:
        return len(self._waiting) + (self._open_goal is not None)

    def turn(self, now_ns: int) -> None:
        """Continue all goals."""
        server = self._endpoint
        if server is None:
            return
        try:
            if self._writer is not None:
                self._look(server, now_ns)
        finally:
            self._receive(server, now_ns)
        self._hand_out(server, now_ns)
        self._inform()
        if now_ns >= self._tick_ns:
            self._tick_ns = now_ns + _TICK_NS
            server.tick()
        goal = self._open_goal
        if goal is not None:
            self._leave_note(goal, server)
        state = server.status(goal.uuid) if goal is not None and goal.accepted else None
        self.goal_status = state.name.lower() if state else "waiting" if goal is not None else ""
        self.due_ns = now_ns + (LOOK_NS if goal is not None or self._waiting else IDLE_NS)

    # -- a goal's beginning and end

    def _receive(self, server: ActionServer, now_ns: int) -> None:
        """Queue the goals that have arrived, or reject them; note which goals are to be canceled."""
        refused = Counter(server.refused) - self._refused
        self._refused += refused
        for reason in refused.elements():
            self.received += 1
            self._count("not executed", reason, now_ns)
        for _ in range(len(self.events)):  # what comes meanwhile waits for the next turn
            what, uuid, *payload = self.events.popleft()
            goal = self._open_goal
            if what == "cancel":
                self._wish_away(uuid, now_ns)
                continue
            if goal is not None and goal.uuid == uuid:
                server.reject(uuid)  # sent again, to a bridge that was restarted
                continue
            self.received += 1
            record, reason, text = self._read(Part.GOAL, payload[0])
            goal = _Goal(uuid, record)
            if text:
                self._end(goal, "not executed", reason or Reason.REJECTED, now_ns, text)
            else:
                self._enqueue(goal, now_ns)

    def _enqueue(self, goal: _Goal, now_ns: int) -> None:
        replaces, busy = self.plan.on_new_goal == "abort", self._open_goal is not None
        if self._down:
            self._end(goal, "not executed", Reason.PLC_DOWN, now_ns)
        elif self._waiting and replaces:
            self._end(self._waiting.popleft(), "not executed", Reason.QUEUE_FULL, now_ns)
            self._waiting.append(goal)
        elif len(self._waiting) < max(self.plan.queue, replaces) + (not busy):
            self._waiting.append(goal)
        else:
            self._end(goal, "not executed", Reason.QUEUE_FULL, now_ns)

    def _wish_away(self, uuid: bytes, now_ns: int) -> None:
        goal = self._open_goal
        if goal is not None and goal.uuid == uuid:
            goal.cancel, goal.unwanted = goal.accepted, not goal.accepted
        for waits in [one for one in self._waiting if one.uuid == uuid]:
            self._waiting.remove(waits)
            self._end(waits, "not executed", Reason.CALLER_GONE, now_ns)

    def _hand_out(self, server: ActionServer, now_ns: int) -> None:
        for goal in tuple(self._waiting):
            reason = Reason.PLC_DOWN if self._down else Reason.NONE
            if reason or not server.present(goal.uuid):
                self._waiting.remove(goal)
                self._end(goal, "not executed", reason or Reason.CALLER_GONE, now_ns)
        if not self._waiting or self._open_goal is not None or not self._peer.alive:
            return
        goal, caller = self._waiting[0], self._caller
        assert caller is not None
        goal.stamp_ns = self.context.clock.time_ns()
        goal.note = b""  # it may have been left in other objects
        self._leave_note(goal, server)
        goal.number = caller.call(self._sends(goal), client=goal.uuid)
        goal.handed_ns = now_ns
        self._open_goal = self._waiting.popleft()

    def _leave_note(self, goal: _Goal, server: ActionServer) -> None:
        """Store what the next bridge must know about a goal, if it has changed (M30)."""
        note = server.note(goal.uuid)
        if note and note != goal.note and self._notes is not None:
            self._notes.write(goal.uuid, note)
            goal.note = note

    def _sends(self, goal: _Goal) -> Callable[..., None]:
        """Return the function that publishes a message of a goal."""
        caller, send = self._caller, partial(self._send, goal.record, stamp_ns=goal.stamp_ns)
        assert caller is not None
        # Each says who acted on goals when it was handed out, for a bridge that comes later.
        return lambda **words: send(**words, reason=caller.claimed)

    def _inform(self) -> None:
        """Tell the PLC what is requested for the goal that it has accepted.

        Each message is sent after the PLC has seen the previous one: a repeated message is another request to
        cancel. ``CALL`` alone is never sent, because a restarted program would treat it as a new goal.
        """
        goal, writer = self._open_goal, self._writer
        if goal is None or not goal.accepted or writer is None or self._taken != writer.head:
            return
        ask = goal.asked | spec.ASK_CANCEL * goal.cancel
        if not goal.cancel or ask != goal.asked:  # another message than the one before
            preempts = bool(self._waiting) and self.plan.on_new_goal == "abort"
            ask = ask & spec.ASK_CANCEL | spec.ASK_PREEMPT * preempts or spec.ASK_ACCEPTED
        if goal.cancel or ask != goal.asked:
            assert self._caller is not None
            self._caller.again(self._sends(goal), ask)
            goal.asked, goal.cancel = ask, False

    def _withdraw(self, goal: _Goal) -> bool:
        """Tell the PLC that no client awaits its decision; return whether the goal may have begun (M26)."""
        assert self._caller is not None
        begun = goal.withdrawn or self._caller.withdraw(self._sends(goal))
        goal.withdrawn = True  # only now: what could not be withdrawn may still begin
        return begun

    def _end(self, goal: _Goal, outcome: Outcome, reason: Reason, now_ns: int, text: str = "") -> None:
        """Count a goal that the PLC will not end, and tell its client; an accepted goal is aborted."""
        server = self._endpoint
        if goal is self._open_goal:
            self._open_goal = None
        if goal.accepted:
            self._count("aborted", reason, now_ns)
            self.note(now_ns, f"an accepted goal was aborted: {text or WORDS[reason]}", "SHM141")
        else:
            self._count(outcome, reason, now_ns, text)
        if server is not None:
            (server.abort if goal.accepted else server.reject)(goal.uuid)

    # -- the open goal

    def _look(self, server: ActionServer, now_ns: int) -> None:
        """Check the PLC's side and the state of the open goal."""
        claim, beat, beat_ms, self._taken = self._channels[Part.GOAL].region.words(spec.reader_line(0), 4)
        self._observe(claim, beat, self._taken, beat_ms, now_ns)
        self._take_answers(now_ns)
        self._take_feedback(server)
        goal, caller = self._open_goal, self._caller
        if goal is None or caller is None:
            return
        if not caller.correlation:  # an earlier bridge's, whose objects were replaced
            self._end(goal, "fate unknown", Reason.BRIDGE_RESTARTED, now_ns, _GONE)
            return
        # Behind a claim that has changed, what was answered before has been looked for.
        if caller.claim() == claim and (outcome := caller.lost(self._sends(goal))):
            self._end(goal, _ENDS[outcome], Reason.PLC_DOWN, now_ns)
        elif not goal.accepted and not goal.withdrawn:
            self._judge(server, goal, now_ns)

    def _judge(self, server: ActionServer, goal: _Goal, now_ns: int) -> None:
        """Withdraw a goal that the PLC does not decide on, or whose client no longer waits."""
        reason = Reason.NONE
        if self._peer.silent:
            reason = Reason.PLC_DOWN
        elif now_ns - goal.handed_ns > self.plan.accept_within_ns:
            reason = Reason.EXPIRED
        elif goal.unwanted or not server.present(goal.uuid):
            reason = Reason.CALLER_GONE
        if reason and not self._withdraw(goal):
            self._end(goal, "not executed", reason, now_ns)

    def _answered(self, payload: bytes, info: SlotInfo, now_ns: int) -> None:
        goal, caller, server = self._open_goal, self._caller, self._endpoint
        answer = 0 if caller is None else caller.answer(info)
        if goal is None or caller is None or server is None or not answer:
            self.strays += 1
            return
        self._check_claims()
        if answer in _OF_ACCEPTED:
            self._follow(server, goal, payload, info.status, now_ns)
        elif caller.correlation:
            self.strays += 1  # nothing that a goal can be answered with
        else:
            reason = Reason(info.reason) if info.reason in list(Reason) else Reason.NONE
            self._end(goal, _ENDS.get(answer, "fate unknown"), reason, now_ns)

    def _follow(self, server: ActionServer, goal: _Goal, payload: bytes, status: int, now_ns: int) -> None:
        """Bring a goal in ROS to the state that it has in the PLC, through all steps in between."""
        self._accept(server, goal)
        answer = status & spec.ANSWER_MASK
        if status & spec.ANSWER_CANCEL_ACCEPTED or answer == spec.ANSWER_CANCELED:
            server.accept_cancel(goal.uuid, asked=bool(goal.asked & spec.ASK_CANCEL))
        elif status & spec.ANSWER_CANCEL_REJECTED and not goal.cancel:
            server.reject_cancel(goal.uuid)
        if answer == spec.ANSWER_ACCEPTED:
            return
        self._take_feedback(server)
        self._open_goal = None
        if answer == spec.ANSWER_SUCCEEDED and server.succeed(goal.uuid, payload):
            self._count("succeeded", Reason.NONE, now_ns)
        elif answer == spec.ANSWER_CANCELED and server.canceled(goal.uuid, payload):
            self._count("canceled", Reason.NONE, now_ns)
        else:  # a goal without a request to cancel it cannot be canceled in ROS
            server.abort(goal.uuid, payload)
            self._count("aborted", Reason.NONE, now_ns)

    def _accept(self, server: ActionServer, goal: _Goal) -> None:
        if goal.accepted:
            return
        goal.accepted = True
        if goal.inherited:
            server.reject(goal.uuid)  # should its client have sent it again
            server.adopt(goal.uuid, goal.stamp_ns, GoalStatus.EXECUTING, goal.note)
            return
        # Accepted while it was being withdrawn: a client that has gone does not know of it.
        goal.cancel = goal.unwanted or not server.present(goal.uuid)
        server.accept(goal.uuid)
        server.execute(goal.uuid)

    def _take_feedback(self, server: ActionServer) -> None:
        goal, reader = self._open_goal, self._readers[Part.FEEDBACK]
        if goal is not None and not goal.accepted:
            return  # it may be this goal's, whose acceptance was not seen yet
        found = reader.latest_wire(self._codecs[Part.FEEDBACK].plan)
        if goal is not None and found is not None and found[1].correlation == goal.number:
            self.feedback += server.feedback(goal.uuid, found[0])

    # -- a goal of an earlier bridge, or of objects that were left

    def _find(
        self, channels: Mapping[Part, Mapped], passed_on: int
    ) -> tuple[_Goal, SlotInfo, SlotInfo | None] | None:
        """Return the goal that an earlier bridge left open, its newest message, and the PLC's answer."""
        found, answer = (self._newest(part, channels) for part in self.plan.parts[:2])
        if found is None or not found[1].status & spec.ASK_CALL:
            return None
        record, info = found
        said = answer[1] if answer is not None and answer[1].correlation == info.correlation else None
        answer_of = 0 if said is None else said.status & spec.ANSWER_MASK
        if said is not None and answer_of != spec.ANSWER_ACCEPTED and said.sequence == passed_on:
            return None
        goal = _Goal(info.client, record, info.stamp_ns, info.correlation, self._now())
        goal.note = GoalNotes(channels[Part.GOAL]).left(goal.uuid)
        goal.inherited, goal.accepted = True, answer_of in _OF_ACCEPTED
        goal.asked = info.status & (spec.ASK_CANCEL | spec.ASK_PREEMPT) or spec.ASK_ACCEPTED
        return goal, info, said

    def _found(self, before: Mapping[Part, Mapped]) -> _Goal | None:
        found = self._find(before, start_of(before[Part.RESULT].region, latched=False, line=0))
        return found[0] if found is not None and found[0].accepted else None

    def _bereft(self, left: _Goal) -> None:
        self._open_goal = left  # the next look ends it
        self.received += 1

    def _claimed(self) -> None:
        caller = Caller(self._channels[Part.GOAL], self._writers[Part.GOAL], follows_claim=True)
        self._caller, goal, now = caller, self._open_goal, self._now()
        self._notes = GoalNotes(self._channels[Part.GOAL])
        if self._known:
            found = self._newest(Part.GOAL)
            if goal is not None and found is not None and found[1].correlation == goal.number:
                caller.resume(found[1])
            elif goal is not None:
                self._end(goal, "fate unknown", Reason.BRIDGE_RESTARTED, now, _GONE)
            return
        left = self._find(self._channels, self._readers[Part.RESULT].last)
        if left is None:
            return
        goal, info, said = left
        self._open_goal, self._again = goal, said is not None
        self.received += 1
        caller.resume(info)
        # Accepted without a word to its client, it is to be canceled.
        goal.cancel = not self._again or bool(info.status & spec.ASK_WITHDRAWN)
        if not self._again and not self._withdraw(goal):
            self._end(goal, "not executed", Reason.BRIDGE_RESTARTED, now)

    # -- leaving

    def _let_go(self, now_ns: int) -> None:
        goal, server = self._open_goal, self._endpoint
        if goal is None or server is None:
            return
        with suppress(RosplcError, OSError, ValueError, AssertionError, KeyError):
            self._take_answers(now_ns)
        if self._open_goal is None or goal.accepted:
            return
        with suppress(RosplcError, OSError, ValueError, AssertionError):
            if not self._withdraw(goal):
                # It goes to the next objects; what the PLC has begun goes on, if its objects remain.
                self._open_goal, goal.withdrawn = None, False
                self._waiting.appendleft(goal)

    def finish(self, now_ns: int) -> None:
        """Reject goals that the PLC has not accepted; an accepted goal is left to the next bridge."""
        server = self._endpoint
        if server is None:
            return
        with suppress(RosplcError, ValueError, OSError):
            self._receive(server, now_ns)
        self._let_go(now_ns)
        if (goal := self._open_goal) is not None and not goal.accepted:
            self._end(goal, "fate unknown", Reason.BRIDGE_RESTARTED, now_ns)
        while self._waiting:
            self._end(self._waiting.popleft(), "not executed", Reason.BRIDGE_RESTARTED, now_ns)

    def give_up(self, now_ns: int) -> None:
        """End all goals: the objects are about to be retired."""
        self.finish(now_ns)
        if (goal := self._open_goal) is not None and self._caller is not None:
            with suppress(RosplcError, OSError, ValueError, AssertionError):
                self._caller.again(self._sends(goal), spec.ASK_CANCEL)
            self._end(goal, "fate unknown", Reason.BRIDGE_RESTARTED, now_ns, _GONE)
