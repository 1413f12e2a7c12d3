"""Goals from ROS to the PLC: every way in which one can end, with the real engine, on a stepped clock."""

from __future__ import annotations

import itertools
import struct
from collections.abc import Callable, Iterator
from typing import Any

import pytest

from rosplc.bridge.carrier import CallPorts
from rosplc.bridge.port import Context
from rosplc.bridge.served import ServedGoals
from rosplc.bridge.status import ActionStatus
from rosplc.config import parse_config, resolve
from rosplc.errors import BackendError, ChannelError
from rosplc.reasons import Reason
from rosplc.ros import EndpointStatus, actions, goals
from rosplc.ros.actionlib import uuid_of
from rosplc.ros.goals import CancelCode, GoalStatus
from rosplc.shm import ACTION, Answerer, Namespace, Part, SlotInfo, attach
from rosplc.shm.constants import (
    ANSWER_ABORTED,
    ANSWER_ACCEPTED,
    ANSWER_CANCEL_ACCEPTED,
    ANSWER_CANCEL_REJECTED,
    ANSWER_CANCELED,
    ANSWER_DONE,
    ANSWER_FATE_UNKNOWN,
    ANSWER_MASK,
    ANSWER_NOT_EXECUTED,
    ANSWER_SUCCEEDED,
    ASK_ACCEPTED,
    ASK_CALL,
    ASK_CANCEL,
    ASK_PREEMPT,
    ASK_WITHDRAWN,
    WRITER_LINE,
)
from tests.lib.channels import acting_reader
from tests.lib.clock import SteppedClock
from tests.unit.bridge.conftest import MESSAGES

TYPE, TYPE_1 = "example_interfaces/action/Fibonacci", "actionlib_tutorials/action/Fibonacci"
A, B, C = (bytes([number] * 16) for number in (1, 2, 3))
REJECTED, ACCEPTED = False, True


class Endpoint:
    """A topic or service of the graph, whose peers the test plays."""

    def __init__(self, on_request: Any = None) -> None:
        self.on_request = on_request
        self.said: list[Any] = []
        self.gone: set[bytes] = set()
        self.remembers = False

    def write(self, payload: bytes, stamp_ns: int = 0) -> bool:
        self.said.append(payload)
        return True

    def reply(self, caller: bytes, payload: bytes) -> bool:
        self.said.append((caller, payload))
        return caller not in self.gone

    def refuse(self, caller: bytes, text: str) -> bool:
        return caller not in self.gone

    def present(self, caller: bytes) -> bool:
        return caller not in self.gone

    def status(self) -> EndpointStatus:
        return EndpointStatus("/a", TYPE, "in", matched=1)

    def close(self) -> None:
        """Nothing is open."""


class Ros:
    """A graph with clients of the action: what they ask for is handled at once."""

    capabilities = frozenset({"services"})
    name = "fake"

    def __init__(self) -> None:
        self.ends: dict[str, Endpoint] = {}

    def advertise(self, topic: str, type_name: str, qos: Any) -> Endpoint:
        return self.ends.setdefault(topic.rpartition("/")[2], Endpoint())

    def subscribe(self, topic: str, type_name: str, qos: Any, on_raw: Any) -> Endpoint:
        return self.serve(topic, type_name, qos, on_raw)

    def serve(self, service: str, type_name: str, qos: Any, on_request: Any) -> Endpoint:
        end = self.advertise(service, type_name, qos)
        end.on_request = on_request
        return end

    def send(self, uuid: bytes, order: int = 5) -> None:
        goal = b"\0\1\0\0" + order.to_bytes(4, "little")
        self.ends["send_goal"].on_request(goals.wrap(uuid, goal), uuid, 0)

    def cancel(self, uuid: bytes) -> None:
        self.ends["cancel_goal"].on_request(MESSAGES.pack_cancel(uuid), uuid, 0)

    def ask_result(self, uuid: bytes) -> None:
        self.ends["get_result"].on_request(goals.LITTLE + uuid, uuid, 0)

    @property
    def decisions(self) -> list[tuple[bytes, bool]]:
        return [(who, MESSAGES.read_accepted(data)) for who, data in self.ends["send_goal"].said]

    @property
    def cancels(self) -> list[tuple[bytes, int]]:
        return [(who, MESSAGES.read_canceling(data)[0]) for who, data in self.ends["cancel_goal"].said]

    @property
    def results(self) -> list[tuple[bytes, int, list[int]]]:
        found = []
        for who, data in self.ends["get_result"].said:
            values = [int.from_bytes(data[at : at + 4], "little") for at in range(12, len(data), 4)]
            found.append((who, data[4], values[: data[8]]))
        return found

    @property
    def states(self) -> dict[bytes, int]:
        """The goals on the status topic."""
        return {uuid: status for uuid, _, status in MESSAGES.read_statuses(self.ends["status"].said[-1])}

    @property
    def feedback(self) -> list[tuple[bytes, int]]:
        messages = map(goals.unwrap, self.ends["feedback"].said)
        return [(uuid, payload[8]) for uuid, payload in messages]


class Plc:
    """The PLC's side of the action, one step at a time."""

    def __init__(self, cell: Cell) -> None:
        self.objects = {part: attach(cell.namespace, "/a", write=True, part=part) for part in ACTION}
        self.reader = acting_reader(self.objects[Part.GOAL], "Task", beat_ms=100)
        self.writers = {part: self.objects[part].writer(100) for part in (Part.RESULT, Part.FEEDBACK)}
        self.answerer = Answerer(self.objects[Part.GOAL], self.reader, self.objects[Part.RESULT])
        self._plan = cell.plan

    def beat(self) -> None:
        self.reader.beat()
        for writer in self.writers.values():
            writer.beat()

    def take(self) -> tuple[str, SlotInfo] | None:
        """Take the newest message of the bridge, and tell what it is."""
        record = bytearray(self._plan.goal.size)
        info = self.reader.latest(record)
        if info is None:
            return None
        assert self._plan.goal.to_dict(record) == {"order": 5}
        return self.answerer.take(info), info

    def begin(self, uuid: bytes = A) -> SlotInfo:
        found = self.take()
        assert found is not None
        assert (found[0], found[1].status, found[1].client) == ("begin", ASK_CALL, uuid)
        return found[1]

    def asked(self) -> int:
        """Take a further message of the goal in hand; return what it asks."""
        found = self.take()
        assert found is not None
        assert found[0] == "more"
        return found[1].status & ~ASK_CALL

    def say(
        self, info: SlotInfo, status: int, *sequence: int, reason: int = 0, part: Part = Part.RESULT
    ) -> None:
        record = self._plan.layout(part).pack({"sequence": list(sequence)})
        words = {"correlation": info.correlation, "client": info.client, "status": status, "reason": reason}
        self.writers[part].publish(record, **words)
        if status & ANSWER_MASK != ANSWER_ACCEPTED:
            self.answerer.answered(info.correlation)

    def feed(self, info: SlotInfo, *sequence: int) -> None:
        self.say(info, ANSWER_ACCEPTED, *sequence, part=Part.FEEDBACK)

    def leave(self) -> None:
        for one in self.objects.values():
            one.close()

    def die(self) -> None:
        """Keep the claims, and beat no more."""
        self.beat = lambda: None  # type: ignore[method-assign]


class Cell:
    """One action whose thread is the test's."""

    def __init__(self, namespace: Namespace, entry: str = "", ros1: bool = False) -> None:
        self.distro, self.type_name = ("noetic", TYPE_1) if ros1 else ("jazzy", TYPE)
        self.configure(entry)
        self.namespace = namespace
        self.clock = SteppedClock()
        self.plc: Plc | None = None
        self.plcs: list[Plc] = []
        self.bridge()

    def configure(self, entry: str) -> None:
        action = f"actions: {{/a: {{type: {self.type_name}, server: plc, {entry}}}}}"
        (self.plan,) = resolve(parse_config(f"ros: {{distro: {self.distro}}}\n{action}")).actions

    def bridge(self) -> None:
        """Start a bridge; the one before is gone without a word."""
        context = Context(self.namespace, "cell", bytes(16), self.distro, clock=self.clock)
        self.ros = Ros()
        self.ports = CallPorts(context, 1_000_000)
        use = self.ports.make(self.plan)
        assert isinstance(use, ServedGoals)
        self.use = use
        self.use.open()
        self.use.connect(self.ros)  # type: ignore[arg-type]
        self.ports.add(self.use)
        self.use.begin(self.clock.monotonic_ns())

    def kill(self) -> None:
        """End the bridge so that it can do nothing any more."""
        for channel in self.use._channels.values():
            channel._abandon()  # as in a forked child: claims and words stay

    def restart(self) -> None:
        self.kill()
        self.bridge()
        self.turn(0.02, 2)

    def attach(self) -> Plc:
        """Start the PLC's program, and let the bridge see it live."""
        self.plc = Plc(self)
        self.plcs.append(self.plc)
        self.turn(0.05, 4)
        return self.plc

    def stop_program(self) -> None:
        assert self.plc is not None
        self.plc.leave()
        self.plcs.remove(self.plc)
        self.plc = None

    def turn(self, seconds: float = 0.006, times: int = 1) -> None:
        """Let time pass: the PLC beats, and the thread of the calls goes round."""
        for _ in range(times):
            if self.plc is not None:
                self.plc.beat()
            now = self.clock.advance(seconds)
            _, again = self.ports.take(now)
            for use in again:
                self.ports.remove(use)
                if use.reopen(now):
                    self.ports.add(use)

    @property
    def status(self) -> ActionStatus:
        """The state, with each goal in exactly one number."""
        found = self.use.status(self.clock.monotonic_ns())
        assert isinstance(found, ActionStatus)
        ends = found.succeeded + found.aborted + found.canceled + found.unreadable + found.late
        reasons = sum(found.not_executed.values()) + sum(found.fate_unknown.values())
        assert found.received == ends + reasons + found.outstanding
        return found

    def close(self) -> None:
        for plc in self.plcs:
            plc.leave()
        self.use.close()


Make = Callable[..., Cell]


@pytest.fixture
def make(shm_namespace: Namespace) -> Iterator[Make]:
    cells: list[Cell] = []

    def start(entry: str = "", **more: bool) -> Cell:
        cells.append(Cell(shm_namespace, entry, **more))
        return cells[-1]

    yield start
    for cell in cells:
        cell.close()


def begun(cell: Cell, uuid: bytes = A) -> SlotInfo:
    """Have a goal handed out, and begun by the PLC."""
    cell.ros.send(uuid)
    cell.turn()
    assert cell.plc is not None
    return cell.plc.begin(uuid)


def accepted(cell: Cell, uuid: bytes = A) -> SlotInfo:
    """Have a goal accepted by the PLC."""
    info = begun(cell, uuid)
    assert cell.plc is not None
    cell.plc.say(info, ANSWER_ACCEPTED)
    cell.turn()
    assert cell.ros.states[uuid] == GoalStatus.EXECUTING
    return info


def bring(cell: Cell, how: str) -> None:
    """Have a goal ``handed out``, ``begun`` or ``accepted``."""
    if how == "handed out":
        cell.ros.send(A)
        cell.turn()
    else:
        begun(cell) if how == "begun" else accepted(cell)


# -- from the decision to the end


def test_a_goal_is_accepted_followed_and_reached(make: Make) -> None:
    cell = make()
    plc = cell.attach()
    info = begun(cell)
    cell.turn(0.02, 5)
    assert (cell.ros.decisions, cell.status.goal_status) == ([], "waiting")
    plc.say(info, ANSWER_ACCEPTED)
    plc.feed(info, 1)
    cell.turn()
    cell.ros.ask_result(A)
    plc.feed(info, 2)
    plc.feed(info, 3)  # the newest alone
    cell.turn()
    assert (cell.ros.decisions, cell.status.goal_status) == ([(A, ACCEPTED)], "executing")
    plc.feed(info, 4)
    plc.say(info, ANSWER_SUCCEEDED, 8, 9)
    cell.turn()
    assert cell.ros.feedback == [(A, 1), (A, 3), (A, 4)]
    assert cell.ros.results == [(A, GoalStatus.SUCCEEDED, [8, 9])]
    plc.feed(info, 5)  # never after the end
    cell.turn()
    assert (len(cell.ros.feedback), cell.status.feedback) == (3, 3)
    assert (cell.status.succeeded, cell.status.outstanding, cell.status.goal_status) == (1, 0, "")
    second = accepted(cell, B)
    plc.say(second, ANSWER_ABORTED, 7)
    cell.turn()
    cell.ros.ask_result(B)
    assert cell.ros.results[1:] == [(B, GoalStatus.ABORTED, [7])]
    assert (cell.status.aborted, second.correlation) == (1, info.correlation + 1)


@pytest.mark.parametrize(
    ("status", "end", "count"),
    [
        (ANSWER_SUCCEEDED, GoalStatus.SUCCEEDED, "succeeded"),
        (ANSWER_ABORTED, GoalStatus.ABORTED, "aborted"),
        (ANSWER_CANCELED, GoalStatus.ABORTED, "aborted"),  # nobody has asked for it
    ],
)
def test_an_end_implies_the_steps_before_it(make: Make, status: int, end: int, count: str) -> None:
    cell = make()
    plc = cell.attach()
    info = begun(cell)
    plc.feed(info, 1)
    plc.say(info, status, 4)
    cell.turn()
    assert cell.ros.decisions == [(A, ACCEPTED)]
    cell.ros.ask_result(A)
    assert cell.ros.results == [(A, end, [4])]
    assert (getattr(cell.status, count), cell.ros.feedback) == (1, [(A, 1)])


@pytest.mark.parametrize(
    ("status", "reason", "kept"),
    [
        (ANSWER_NOT_EXECUTED, Reason.REJECTED, ("not_executed", {"rejected": 1})),
        (ANSWER_FATE_UNKNOWN, Reason.PLC_DOWN, ("fate_unknown", {"plc_down": 1})),
        (ANSWER_DONE, 77, ("fate_unknown", {"none": 1})),
    ],
)
def test_the_plc_does_not_accept(make: Make, status: int, reason: int, kept: Any) -> None:
    cell = make()
    plc = cell.attach()
    plc.say(begun(cell), status, reason=reason)
    cell.turn()
    assert (cell.ros.decisions, cell.ros.states) == ([(A, REJECTED)], {})
    assert getattr(cell.status, kept[0]) == kept[1]
    begun(cell, B)


def test_without_a_plc_no_goal_waits(make: Make) -> None:
    cell = make()
    cell.ros.send(A)
    cell.turn()
    assert cell.ros.decisions == [(A, REJECTED)]
    plc = cell.attach()
    assert plc.take() is None
    assert cell.status.not_executed == {"plc_down": 1}
    assert cell.status.judgement[1].startswith("call not executed")


def test_a_goal_that_does_not_fit_is_rejected(make: Make) -> None:
    cell = make()
    cell.attach()
    cell.ros.ends["send_goal"].on_request(goals.wrap(A, b"\0\1\0\0"), A, 0)
    cell.turn()
    assert (cell.ros.decisions, cell.status.not_executed) == ([(A, REJECTED)], {"rejected": 1})


# -- other goals meanwhile


def test_another_goal_is_rejected(make: Make) -> None:
    cell = make()
    plc = cell.attach()
    info = begun(cell)
    cell.ros.send(B)
    cell.turn()
    assert cell.ros.decisions == [(B, REJECTED)]
    assert cell.status.not_executed == {"queue_full": 1}
    plc.say(info, ANSWER_SUCCEEDED)
    cell.turn()
    accepted(cell, C)


def test_goals_wait_in_a_queue(make: Make) -> None:
    cell = make("on_new_goal: buffer, queue: 2")
    plc = cell.attach()
    info = accepted(cell)
    for uuid in (B, C, bytes([4] * 16)):
        cell.ros.send(uuid)
    cell.turn()
    assert cell.ros.decisions[1:] == [(bytes([4] * 16), REJECTED)]
    assert (cell.status.outstanding, plc.take()) == (3, None)
    cell.ros.ends["send_goal"].gone.add(B)
    cell.turn()
    plc.say(info, ANSWER_SUCCEEDED)
    cell.turn()
    second = plc.begin(C)
    assert cell.status.not_executed == {"queue_full": 1, "caller_gone": 1}
    plc.say(second, ANSWER_SUCCEEDED)
    cell.turn()
    assert cell.status.succeeded == 2


def test_a_new_goal_preempts(make: Make) -> None:
    cell = make("on_new_goal: abort")
    plc = cell.attach()
    info = begun(cell)
    cell.ros.send(B)
    cell.turn(times=3)
    assert plc.take() is None  # an undecided goal is left alone: it would count as refused
    plc.say(info, ANSWER_ACCEPTED)
    cell.turn(times=3)
    assert plc.asked() == ASK_PREEMPT
    cell.ros.send(C)
    cell.turn(times=3)
    assert cell.ros.decisions == [(A, ACCEPTED), (B, REJECTED)]
    assert plc.take() is None
    cell.ros.ends["send_goal"].gone.add(C)
    cell.turn(times=2)
    assert plc.asked() == ASK_ACCEPTED  # what was asked is taken back, once, and not as a new goal
    cell.turn(times=3)
    assert plc.take() is None
    cell.ros.ends["send_goal"].gone.clear()
    cell.ros.send(C)
    cell.turn(times=2)
    assert plc.asked() == ASK_PREEMPT
    plc.say(info, ANSWER_ABORTED, 1)
    cell.turn()
    plc.say(plc.begin(C), ANSWER_SUCCEEDED)
    cell.turn()
    assert (cell.status.aborted, cell.status.succeeded) == (1, 1)


# -- the decision that does not come


def test_a_goal_that_nobody_decides_on_is_withdrawn(make: Make) -> None:
    """Without accept_within its client would wait for ever."""
    cell = make("accept_within: 200ms")
    plc = cell.attach()
    cell.ros.send(A)
    cell.turn(0.05, 4)
    assert cell.ros.decisions == []
    cell.turn(0.05, 2)
    assert (cell.ros.decisions, cell.status.not_executed) == ([(A, REJECTED)], {"expired": 1})
    found = plc.take()
    assert found is not None
    assert (found[0], found[1].status) == ("withdrawn", ASK_CALL | ASK_WITHDRAWN)
    plc.say(found[1], ANSWER_NOT_EXECUTED, reason=Reason.CALLER_GONE)
    cell.turn()
    accepted(cell, B)
    assert cell.status.strays == 1


@pytest.mark.parametrize("accepts", [False, True])
def test_a_goal_that_was_begun_is_decided_by_its_answer(make: Make, accepts: bool) -> None:
    cell = make("accept_within: 200ms")
    plc = cell.attach()
    info = begun(cell)
    cell.turn(0.05, 6)
    assert (cell.ros.decisions, cell.status.outstanding) == ([], 1)
    assert plc.asked() == ASK_WITHDRAWN
    plc.say(info, ANSWER_ACCEPTED if accepts else ANSWER_NOT_EXECUTED, reason=Reason.CALLER_GONE)
    cell.turn(times=3)
    assert cell.ros.decisions == [(A, accepts)]
    if not accepts:
        assert cell.status.not_executed == {"caller_gone": 1}
        return
    assert plc.take() is None  # its client still waits: nothing is to be canceled
    plc.say(info, ANSWER_SUCCEEDED, 3)
    cell.turn()
    assert cell.status.succeeded == 1


def test_a_client_that_has_gone(make: Make) -> None:
    """A goal that is accepted nevertheless is canceled."""
    cell = make()
    plc = cell.attach()
    info = begun(cell)
    cell.ros.ends["send_goal"].gone.add(A)
    cell.turn()
    assert plc.asked() == ASK_WITHDRAWN
    plc.say(info, ANSWER_ACCEPTED)
    cell.turn(times=2)
    assert plc.asked() == ASK_CANCEL
    plc.say(info, ANSWER_CANCELED | ANSWER_CANCEL_ACCEPTED, 1)
    cell.turn()
    assert (cell.status.canceled, cell.status.outstanding) == (1, 0)
    cell.ros.ends["send_goal"].gone.add(B)
    cell.ros.send(B)
    cell.turn()
    assert cell.status.not_executed == {"caller_gone": 1}


# -- canceling


def test_feedback_that_cannot_be_sent_holds_no_request_up(make: Make) -> None:
    """As of a node that is inactive, while the PLC's program sends feedback in each scan."""
    cell = make()
    plc = cell.attach()
    info = accepted(cell)

    def refuse(*_: Any) -> bool:
        raise BackendError("ROS009", "the node is not active")

    cell.ros.ends["feedback"].write = refuse  # type: ignore[method-assign]
    cell.ros.cancel(A)
    for number in range(5):
        plc.feed(info, number)
        cell.turn(0.1)
    assert plc.asked() == ASK_CANCEL
    assert (cell.status.feedback, cell.status.reason) == (0, "")


def test_a_goal_is_canceled(make: Make) -> None:
    cell = make()
    plc = cell.attach()
    info = accepted(cell)
    cell.ros.cancel(A)
    cell.turn()
    assert (plc.asked(), cell.ros.cancels) == (ASK_CANCEL, [])
    plc.say(info, ANSWER_ACCEPTED | ANSWER_CANCEL_ACCEPTED)
    cell.turn()
    assert cell.ros.cancels == [(A, CancelCode.NONE)]
    assert cell.status.goal_status == "canceling"
    plc.say(info, ANSWER_CANCELED | ANSWER_CANCEL_ACCEPTED, 6)
    cell.turn()
    cell.ros.ask_result(A)
    assert cell.ros.results == [(A, GoalStatus.CANCELED, [6])]
    assert cell.status.canceled == 1


@pytest.mark.parametrize(
    ("status", "agreed", "end"),
    [
        (ANSWER_CANCELED | ANSWER_CANCEL_ACCEPTED, True, GoalStatus.CANCELED),
        (ANSWER_CANCELED, True, GoalStatus.CANCELED),
        (ANSWER_SUCCEEDED | ANSWER_CANCEL_ACCEPTED, True, GoalStatus.SUCCEEDED),
        (ANSWER_SUCCEEDED | ANSWER_CANCEL_REJECTED, False, GoalStatus.SUCCEEDED),
        (ANSWER_ABORTED, False, GoalStatus.ABORTED),
    ],
)
def test_an_end_decides_on_a_request_to_cancel(make: Make, status: int, agreed: bool, end: int) -> None:
    cell = make()
    plc = cell.attach()
    info = accepted(cell)
    cell.ros.cancel(A)
    cell.turn()
    plc.say(info, status)
    cell.turn()
    assert cell.ros.cancels == [(A, CancelCode.NONE if agreed else CancelCode.REJECTED)]
    assert cell.ros.states[A] == end


def test_a_request_to_cancel_is_repeated_after_a_refusal(make: Make) -> None:
    """The same message again is another request; one that asks for more meanwhile waits behind it."""
    cell = make("on_new_goal: abort")
    plc = cell.attach()
    info = accepted(cell)
    for _ in range(2):
        cell.ros.cancel(A)
        cell.turn()
        assert plc.asked() == ASK_CANCEL
        plc.say(info, ANSWER_ACCEPTED | ANSWER_CANCEL_REJECTED)
        cell.turn()
    assert cell.ros.cancels == [(A, CancelCode.REJECTED)] * 2
    cell.ros.cancel(A)
    cell.ros.send(B)
    cell.turn(times=4)
    assert plc.asked() == ASK_CANCEL  # not overtaken by the other
    cell.turn()
    assert plc.asked() == ASK_CANCEL | ASK_PREEMPT
    plc.say(info, ANSWER_CANCELED | ANSWER_CANCEL_ACCEPTED)
    cell.turn()
    plc.begin(B)
    assert cell.ros.cancels[2:] == [(A, CancelCode.NONE)]


# -- the PLC's life


@pytest.mark.parametrize("again", [False, True])
@pytest.mark.parametrize("how", ["handed out", "begun", "accepted"])
def test_the_plc_stops_or_starts_again(make: Make, how: str, again: bool) -> None:
    cell = make()
    cell.attach()
    bring(cell, how)
    cell.stop_program()
    if again:
        cell.plc = Plc(cell)
        cell.plcs.append(cell.plc)
    cell.turn(0.02, 4)
    if how == "accepted":
        assert (cell.ros.states[A], cell.status.aborted) == (GoalStatus.ABORTED, 1)
        assert "aborted: the PLC program stopped" in cell.status.reason
    elif how == "begun":
        assert (cell.ros.decisions, cell.status.fate_unknown) == ([(A, REJECTED)], {"plc_down": 1})
    else:
        assert (cell.ros.decisions, cell.status.not_executed) == ([(A, REJECTED)], {"plc_down": 1})
    if again:
        found = cell.plc.take() if cell.plc is not None else None
        assert found is not None
        assert found[0] in ("withdrawn", "unknown")  # never "begin"
        begun(cell, B)


def test_a_program_that_starts_while_a_goal_is_handed_out(make: Make, monkeypatch: Any) -> None:
    """What the message says of the claim is what this bridge goes by, and not an earlier look."""
    cell = make()
    cell.attach()
    caller = cell.use._caller
    assert caller is not None
    monkeypatch.setattr(caller, "claim", itertools.count(7).__next__)  # another one at each look
    cell.ros.send(A)
    cell.turn()
    assert cell.plc is not None
    found = cell.plc.take()
    assert found is not None
    assert found[1].reason == caller.claimed


def test_what_the_plc_said_before_it_stopped_counts(make: Make) -> None:
    cell = make()
    plc = cell.attach()
    plc.say(accepted(cell), ANSWER_SUCCEEDED, 1)
    cell.stop_program()
    cell.turn()
    assert (cell.status.succeeded, cell.status.aborted) == (1, 0)


@pytest.mark.parametrize("asked", [False, True])
def test_a_silent_plc_keeps_its_goal(make: Make, asked: bool) -> None:
    """It may still move: nothing is reported until it says so, but nothing else is handed out."""
    cell = make("on_new_goal: buffer")
    plc = cell.attach()
    info = accepted(cell)
    cell.ros.send(B)
    cell.turn()
    plc.die()
    if asked:
        cell.ros.cancel(A)
    cell.turn(0.1, 200)
    assert cell.ros.states == {A: GoalStatus.EXECUTING}
    assert cell.ros.decisions == [(A, ACCEPTED), (B, REJECTED)]
    assert (cell.ros.cancels, cell.status.aborted) == ([], 0)
    assert cell.status.judgement[1] == "the PLC is silent; the goal is still executing"
    del plc.__dict__["beat"]
    cell.turn(0.05, 4)
    plc.say(info, ANSWER_SUCCEEDED)
    cell.turn()
    assert cell.status.succeeded == 1


@pytest.mark.parametrize("taken", [False, True])
def test_a_plc_that_falls_silent_before_its_decision(make: Make, taken: bool) -> None:
    cell = make()
    plc = cell.attach()
    cell.ros.send(A)
    cell.turn()
    if taken:
        plc.begin()
    plc.die()
    cell.turn(0.1, 8)
    assert cell.ros.decisions == [] if taken else [(A, REJECTED)]
    assert cell.status.not_executed == ({} if taken else {"plc_down": 1})


# -- the bridge's life


def test_a_restarted_bridge_adopts_an_accepted_goal(make: Make) -> None:
    """It is published again, can be canceled, gives feedback, and its result is delivered."""
    cell = make()
    plc = cell.attach()
    info = accepted(cell)
    accepted_at = cell.use._open_goal.stamp_ns  # type: ignore[union-attr]
    cell.turn(0.5, 2)
    cell.restart()
    assert plc.take() is None  # nothing is handed out again, nor asked for
    assert MESSAGES.read_statuses(cell.ros.ends["status"].said[-1]) == [
        (A, accepted_at, GoalStatus.EXECUTING)
    ]
    plc.feed(info, 2)
    cell.turn()
    cell.ros.ask_result(A)
    cell.ros.cancel(A)
    cell.turn()
    assert plc.asked() == ASK_CANCEL
    plc.say(info, ANSWER_CANCELED | ANSWER_CANCEL_ACCEPTED, 5)
    cell.turn()
    assert cell.ros.feedback == [(A, 2)]
    assert cell.ros.results == [(A, GoalStatus.CANCELED, [5])]
    assert (cell.status.received, cell.status.canceled) == (1, 1)


def test_a_result_asked_for_before_the_first_turn_waits(make: Make) -> None:
    """And so does a request to cancel: the goal is known before the endpoints are."""
    cell = make()
    plc = cell.attach()
    info = accepted(cell)
    cell.kill()
    cell.bridge()
    cell.ros.ask_result(A)
    cell.ros.cancel(A)
    assert (cell.ros.results, cell.ros.cancels) == ([], [])
    cell.turn(0.02, 2)
    assert plc.asked() == ASK_CANCEL
    plc.say(info, ANSWER_SUCCEEDED, 4)
    cell.turn()
    assert cell.ros.results == [(A, GoalStatus.SUCCEEDED, [4])]


def test_the_next_bridge_names_a_goal_of_actionlib(make: Make) -> None:
    """A client knows its goal by a text that the UUID does not tell."""
    cell = make(ros1=True)
    plc = cell.attach()
    text = b"/robot-1-1700000000.123456789"
    goal_id = struct.pack("<3I", 9, 0, len(text)) + text
    cell.ros.ends["goal"].on_request(bytes(16) + goal_id + struct.pack("<i", 5), 0)
    cell.turn()
    info = plc.begin(uuid_of(text))
    plc.say(info, ANSWER_ACCEPTED)
    cell.turn()
    for _ in range(2):
        cell.restart()
        assert text + b"\1" in cell.ros.ends["status"].said[-1]  # active
    cell.ros.ends["cancel"].on_request(goal_id, 0)
    cell.turn()
    assert plc.asked() == ASK_CANCEL
    plc.say(info, ANSWER_CANCELED | ANSWER_CANCEL_ACCEPTED, 5)
    cell.turn()
    assert text + b"\2" in cell.ros.ends["result"].said[-1]  # preempted
    assert cell.status.canceled == 1


@pytest.mark.parametrize("when", ["while it runs", "ended without a bridge", "other objects"])
def test_a_result_asked_for_before_a_restart(make: Make, when: str) -> None:
    """The next bridge answers who has asked, whose middleware may know the caller again."""
    cell = make()
    plc = cell.attach()
    info = accepted(cell)
    cell.ros.ask_result(A)
    cell.turn()
    for _ in range(3):  # each bridge leaves it to the next
        cell.restart()
    cell.kill()
    if when == "ended without a bridge":
        plc.say(info, ANSWER_SUCCEEDED, 4)
    elif when == "other objects":
        cell.plc = None
        cell.configure("limits: {result.sequence: 9}")
    cell.bridge()
    cell.turn(0.02, 2)
    if when == "while it runs":
        assert cell.ros.results == []
        plc.say(info, ANSWER_SUCCEEDED, 4)
        cell.turn()
    lost = when == "other objects"
    assert cell.ros.results == [(A, GoalStatus.ABORTED, []) if lost else (A, GoalStatus.SUCCEEDED, [4])]


@pytest.mark.parametrize("agreed", ["before the kill", "after it", "at its end"])
def test_a_cancel_of_before_a_restart(make: Make, agreed: str) -> None:
    cell = make()
    plc = cell.attach()
    info = accepted(cell)
    cell.ros.cancel(A)
    cell.turn()
    assert plc.asked() == ASK_CANCEL
    if agreed == "before the kill":
        plc.say(info, ANSWER_ACCEPTED | ANSWER_CANCEL_ACCEPTED)
    cell.restart()
    if agreed == "after it":
        plc.say(info, ANSWER_ACCEPTED | ANSWER_CANCEL_ACCEPTED)
        cell.turn()
    canceling = agreed != "at its end"
    assert cell.ros.states == {A: GoalStatus.CANCELING if canceling else GoalStatus.EXECUTING}
    plc.say(info, ANSWER_CANCELED | ANSWER_CANCEL_ACCEPTED, 5)
    cell.turn()
    cell.ros.ask_result(A)
    assert cell.ros.results == [(A, GoalStatus.CANCELED, [5])]
    assert (cell.status.canceled, cell.status.aborted) == (1, 0)


@pytest.mark.parametrize("bits", [0, ANSWER_CANCEL_ACCEPTED])
def test_what_the_plc_did_without_a_bridge_is_passed_on(make: Make, bits: int) -> None:
    cell = make()
    plc = cell.attach()
    info = accepted(cell)
    if bits:
        cell.ros.cancel(A)
        cell.turn()
    cell.kill()
    plc.say(info, ANSWER_ACCEPTED | bits)
    cell.bridge()
    cell.turn(0.02, 2)
    assert cell.ros.states == {A: GoalStatus.CANCELING if bits else GoalStatus.EXECUTING}
    cell.kill()
    plc.say(info, (ANSWER_CANCELED if bits else ANSWER_SUCCEEDED) | bits, 9)
    cell.bridge()
    cell.turn(0.02, 2)
    cell.ros.ask_result(A)
    assert cell.ros.results == [(A, GoalStatus.CANCELED if bits else GoalStatus.SUCCEEDED, [9])]
    cell.restart()  # it was passed on
    assert (cell.ros.states, cell.status.received) == ({}, 0)


@pytest.mark.parametrize("how", ["begun", "accepted", "ended", "passed on"])
def test_limits_that_change_without_a_bridge(make: Make, how: str) -> None:
    """Other objects take the place of the goal's: it is aborted, unless no client knows of it."""
    cell = make()
    plc = cell.attach()
    info = begun(cell) if how == "begun" else accepted(cell)
    if how == "passed on":
        plc.say(info, ANSWER_SUCCEEDED)
        cell.turn()
    cell.kill()
    if how == "ended":
        plc.say(info, ANSWER_SUCCEEDED, 1)
    cell.plc = None
    cell.configure("limits: {result.sequence: 9}")
    cell.bridge()
    cell.ros.ask_result(A)
    cell.turn(0.02, 2)
    lost = how in ("accepted", "ended")
    assert cell.ros.states == ({A: GoalStatus.ABORTED} if lost else {})
    assert cell.ros.results == [(A, GoalStatus.ABORTED if lost else GoalStatus.UNKNOWN, [])]
    assert (cell.status.received, cell.status.aborted) == (lost, lost)
    cell.attach()
    begun(cell, B)


@pytest.mark.parametrize("how", ["handed out", "begun", "begun and accepted later"])
def test_a_restarted_bridge_hands_no_goal_out_twice(make: Make, how: str) -> None:
    cell = make()
    plc = cell.attach()
    cell.ros.send(A)
    cell.turn()
    if how != "handed out":
        info = plc.begin()
    cell.restart()
    if how == "handed out":
        assert cell.status.not_executed == {"bridge_restarted": 1}
        found = plc.take()
        assert found is not None
        assert (found[0], found[1].status) == ("withdrawn", ASK_CALL | ASK_WITHDRAWN)
        plc.say(found[1], ANSWER_NOT_EXECUTED)
        cell.turn()
        begun(cell, B)
        return
    assert plc.asked() == ASK_WITHDRAWN
    cell.ros.send(A)  # again
    cell.turn()
    assert cell.ros.decisions == [(A, REJECTED)]
    if how == "begun":
        plc.say(info, ANSWER_NOT_EXECUTED, reason=Reason.CALLER_GONE)
        cell.turn()
        assert cell.status.not_executed == {"caller_gone": 1}
    else:
        plc.say(info, ANSWER_ACCEPTED)
        cell.turn(times=3)
        assert cell.ros.states == {A: GoalStatus.EXECUTING}
        assert plc.asked() == ASK_CANCEL  # its client was never told
        plc.say(info, ANSWER_CANCELED | ANSWER_CANCEL_ACCEPTED)
        cell.turn()
        assert cell.status.canceled == 1
    assert cell.status.received == 1
    begun(cell, B)


@pytest.mark.parametrize("how", ["handed out", "begun", "accepted"])
def test_the_plc_started_again_without_a_bridge(make: Make, how: str) -> None:
    """The goal's messages say under which claim it was handed out."""
    cell = make()
    cell.attach()
    bring(cell, how)
    cell.kill()
    cell.stop_program()
    cell.plc = Plc(cell)
    cell.plcs.append(cell.plc)
    cell.bridge()
    cell.turn(0.02, 3)
    found = cell.plc.take()
    assert found is not None
    assert found[0] in ("withdrawn", "unknown")
    cell.turn(0.02)
    if how == "accepted":
        assert (cell.ros.states, cell.status.aborted) == ({A: GoalStatus.ABORTED}, 1)
    elif how == "begun":
        assert cell.status.fate_unknown == {"plc_down": 1}
    else:
        assert cell.status.not_executed == {"bridge_restarted": 1}
    assert cell.status.outstanding == 0


@pytest.mark.parametrize("how", ["waiting", "handed out", "begun", "accepted"])
def test_an_orderly_stop_leaves_an_accepted_goal(make: Make, how: str) -> None:
    cell = make("on_new_goal: buffer")
    plc = cell.attach()
    if how in ("waiting", "accepted"):
        info = accepted(cell)
    if how == "waiting":
        cell.ros.send(B)
        cell.turn()
    elif how == "handed out":
        cell.ros.send(A)
        cell.turn()
    elif how == "begun":
        info = begun(cell)
    cell.use.finish(cell.clock.monotonic_ns())
    lost = {"waiting": B, "handed out": A, "begun": A}.get(how)
    if lost is not None:
        assert cell.ros.decisions[-1] == (lost, REJECTED)
    kept = cell.status.fate_unknown if how == "begun" else cell.status.not_executed
    assert kept == ({"bridge_restarted": 1} if lost is not None else {})
    assert cell.status.outstanding == (how in ("waiting", "accepted"))
    cell.use.close()
    cell.bridge()
    cell.turn(0.02, 2)
    if how in ("waiting", "accepted"):
        assert cell.ros.states == {A: GoalStatus.EXECUTING}
        assert plc.take() is None
        plc.say(info, ANSWER_SUCCEEDED)
    elif how == "begun":
        assert plc.asked() == ASK_WITHDRAWN
        plc.say(info, ANSWER_NOT_EXECUTED)
    else:
        found = plc.take()
        assert found is not None
        assert found[0] == "withdrawn"
        plc.say(found[1], ANSWER_NOT_EXECUTED)
    cell.turn()
    assert cell.status.outstanding == 0


def test_an_action_that_leaves_the_configuration(make: Make) -> None:
    cell = make()
    plc = cell.attach()
    accepted(cell)
    cell.use.give_up(cell.clock.monotonic_ns())
    assert plc.asked() == ASK_CANCEL
    assert (cell.ros.states, cell.status.aborted) == ({A: GoalStatus.ABORTED}, 1)


@pytest.mark.parametrize("gone", [False, True])
def test_objects_that_are_opened_again(make: Make, gone: bool) -> None:
    """The claim was lost: the goal goes on in the same objects, and ends with objects that are gone."""
    cell = make()
    plc = cell.attach()
    info = accepted(cell)
    cell.use._channels[Part.GOAL].region.store(WRITER_LINE["writer_epoch"], 12345)
    if gone:
        for part in ACTION:
            cell.namespace.path("/a", part).unlink()
    cell.ros.cancel(A)
    cell.turn(0.02, 4)
    if gone:
        assert (cell.ros.states, cell.status.aborted) == ({A: GoalStatus.ABORTED}, 1)
        return
    assert plc.asked() == ASK_CANCEL
    plc.say(info, ANSWER_SUCCEEDED, 1)
    cell.turn()
    assert cell.status.succeeded == 1


@pytest.mark.parametrize("how", ["told", "not told", "gone"])
def test_objects_that_are_opened_again_before_the_decision(make: Make, how: str) -> None:
    """The PLC may accept the goal yet: its client hears that, and not before that it is rejected."""
    cell = make()
    plc = cell.attach()
    info = begun(cell)
    part = Part.GOAL if how == "not told" else Part.FEEDBACK
    cell.use._channels[part].region.store(WRITER_LINE["writer_epoch"], 12345)
    if how == "gone":
        for one in ACTION:
            cell.namespace.path("/a", one).unlink()
    now = cell.clock.monotonic_ns()
    cell.use.fail(now, ChannelError("SHM116", "another bridge has taken the action over"))
    cell.ports.remove(cell.use)
    assert cell.use.reopen(now)
    cell.ports.add(cell.use)
    if how == "gone":
        assert (cell.ros.decisions, cell.status.fate_unknown) == ([(A, REJECTED)], {"bridge_restarted": 1})
        return
    plc.say(info, ANSWER_ACCEPTED)
    cell.turn(times=3)
    assert cell.ros.decisions == [(A, ACCEPTED)]
    plc.say(info, ANSWER_SUCCEEDED)
    cell.turn()
    assert cell.status.succeeded == 1


def test_results_are_kept_for_a_while(make: Make) -> None:
    cell = make("keep_result: 2s")
    plc = cell.attach()
    plc.say(accepted(cell), ANSWER_SUCCEEDED, 1)
    cell.turn(0.5, 3)
    assert cell.ros.states == {A: GoalStatus.SUCCEEDED}
    cell.turn(0.5, 4)
    assert cell.ros.states == {}


def test_goals_that_find_no_room_are_counted(make: Make, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(actions, "MOST_GOALS", 2)
    cell = make("on_new_goal: buffer, queue: 4")
    cell.attach()
    for uuid in (A, B, C, A):
        cell.ros.send(uuid)
    cell.turn()
    assert cell.ros.decisions == [(C, REJECTED), (A, REJECTED)]
    assert (cell.status.not_executed, cell.status.outstanding) == ({"queue_full": 1}, 2)
    cell.use.connect(cell.ros)  # type: ignore[arg-type] - the new endpoint counts from 0
    for uuid in (A, B, C):
        cell.ros.send(uuid)
    cell.turn()
    assert cell.status.not_executed == {"queue_full": 2}


def test_a_goal_that_cannot_be_read_is_counted(make: Make) -> None:
    cell = make()
    cell.ros.ends["send_goal"].on_request(b"\0\1\0\0short", A, 0)
    cell.turn()
    assert cell.status.not_executed == {"rejected": 1}


def test_goals_of_actionlib_that_never_reach_the_queue_are_counted(make: Make) -> None:
    """Those that cannot be read, and those that were canceled before they came."""
    cell = make(ros1=True)
    goal_id = struct.pack("<3I", 9, 0, 3) + b"one"
    with pytest.raises(BackendError, match="ROS008"):
        cell.ros.ends["goal"].on_request(bytes(16) + goal_id[:-1], 0)
    cell.ros.ends["cancel"].on_request(goal_id, 0)
    cell.ros.ends["goal"].on_request(bytes(16) + goal_id + struct.pack("<i", 5), 0)
    cell.turn()
    assert cell.status.not_executed == {"rejected": 1, "caller_gone": 1}


def test_a_flood_of_goals_holds_nothing_up(make: Make) -> None:
    """A turn ends, whatever comes meanwhile."""
    cell = make()
    cell.attach()
    decided: list[bytes] = []

    def reply(caller: bytes, payload: bytes) -> bool:
        decided.append(caller)
        if len(decided) < 100:
            cell.ros.send(len(decided).to_bytes(16, "big"))
        return True

    cell.ros.ends["send_goal"].reply = reply  # type: ignore[method-assign]
    for uuid in (A, B):
        cell.ros.send(uuid)
    cell.turn()
    assert decided == [B]
    cell.turn(times=2)
    assert len(decided) == 3
