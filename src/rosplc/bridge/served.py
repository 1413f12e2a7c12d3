"""Services that the PLC carries out: the bridge is the caller towards the PLC."""

from __future__ import annotations

from abc import abstractmethod
from collections import deque
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from functools import partial

from rosplc.bridge.port import Context
from rosplc.bridge.use import ENDINGS, IDLE_NS, LOOK_NS, Outcome, Use
from rosplc.config.plans import ServicePlan
from rosplc.errors import ChannelError, RosplcError
from rosplc.reasons import Reason
from rosplc.ros import Backend, ServiceServer
from rosplc.shm import Caller, Part, SlotInfo
from rosplc.shm.calls import WORDS
from rosplc.shm.constants import ASK_CALL, ASK_WITHDRAWN, reader_line

_PATIENCE_NS = 10_000_000_000
"""How long an answer to a call of an earlier bridge waits until the middleware has found its caller again."""
_REMEMBERED = 256
"""Callers that came last, whose requests may come twice."""
_CLIENT = 8
"""Bytes of a caller that are the same in all its calls."""


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
    """What the PLC carries out: the bridge is the caller towards the PLC."""

    _caller: Caller | None = None
    _again = False  # the newest answer counts once more: it is to what an earlier bridge asked

    @property
    def _down(self) -> bool:
        """Whether the PLC's block is known to be gone, or there are no objects."""
        return self._writer is None or not self._holder or self._peer.silent

    def _take_answers(self, now_ns: int) -> None:
        """Pass on the newest answer, and only then store that it was taken."""
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
        """Raise ChannelError (SHM116) if answers are not this bridge's any more."""
        if any(reader.line is None for reader in self._readers.values()):
            what = f"another bridge has taken the {self.plan.kind} over"
            raise ChannelError("SHM116", what, where=self.plan.called)


class Served(Calling):
    """A service that the PLC carries out."""

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
        """Go on with all calls."""
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
        """Put requests that came into the queue, or refuse them."""
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
            elif now_ns - call.arrived_ns > self.plan.expire_ns:
                self._end(self._waiting.popleft(), "not executed", Reason.EXPIRED, now_ns)
            elif self._open_call is not None or now_ns < self._next_ns or not self._peer.alive:
                return
            elif not self._present(call):
                self._end(self._waiting.popleft(), "not executed", Reason.CALLER_GONE, now_ns)
            else:
                self._publish(call, now_ns)

    def _publish(self, call: _Call, now_ns: int) -> None:
        """Hand out the call that has waited longest; if that fails, it goes on waiting."""
        assert self._caller is not None
        self._caller.call(partial(self._send, call.record), client=call.caller)
        self._open_call = self._waiting.popleft()
        self._next_ns = now_ns + self.plan.min_interval_ns

    def _withdraw(self, call: _Call) -> bool:
        """Tell the PLC that nobody waits any more; return whether it may have begun (M26)."""
        assert self._caller is not None
        if call.withdrawn:
            return True  # or it would have ended with that
        begun = self._caller.withdraw(partial(self._send, call.record))
        call.withdrawn = True  # only now: what could not be withdrawn may still begin
        return begun or call.inherited

    def _end(self, call: _Call, outcome: Outcome, reason: Reason, now_ns: int, text: str = "") -> None:
        """Count a call that has no answer, and tell its caller what the configuration says."""
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
        """Look at the PLC's side, and at what has become of the open call."""
        claim, beat, beat_ms, taken = self._channels[Part.REQUEST].region.words(reader_line(0), 4)
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
        """Withdraw a call that nobody waits for, or that will not be carried out."""
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
        elif not begun and waited > self.plan.expire_ns:
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
        if self._known or found is None or not found[1].status & ASK_CALL:
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
        call.withdrawn = bool(answered and info.status & ASK_WITHDRAWN)
        call.inherited = answered or self._caller.begun() or self._withdraw(call)
        if not call.inherited:
            self._open_call, call.ended = None, True
            reason = Reason.BRIDGE_RESTARTED
            self._unsent.append((call.caller, self._fallback, "not executed", reason, now + _PATIENCE_NS))
        elif info.status & ASK_WITHDRAWN and not answered:
            # Said again: a program that started in between has seen neither the call nor this.
            self._withdraw(call)

    def _repeat(self, now_ns: int, *, last: bool = False) -> None:
        """Answer callers of an earlier bridge, as soon as the middleware has found them, or now or never."""
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
        """Refuse what waits; what the PLC has begun is left to the next bridge."""
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
