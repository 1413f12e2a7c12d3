"""Goals that the PLC sends to ROS: every way in which one can go on and end, on a stepped clock."""

from __future__ import annotations

import struct
import time
from collections.abc import Callable, Iterator
from functools import partial
from typing import Any

import pytest

from rosplc.bridge.called import CalledGoals
from rosplc.bridge.carrier import CallPorts
from rosplc.bridge.port import Context
from rosplc.bridge.status import ActionStatus
from rosplc.codec import Codec, Wire
from rosplc.config import parse_config, resolve
from rosplc.errors import BackendError
from rosplc.layout import Limits, compute_layout
from rosplc.model import TypeStore
from rosplc.reasons import Reason
from rosplc.ros import SERVICES, ActionServer, GoalStatus, Qos, Reply, actions, goals
from rosplc.ros import goals as wire
from rosplc.ros.memory import MemoryBackend, open_backend
from rosplc.shm import ACTION, Caller, Namespace, Part, attach
from rosplc.shm.constants import (
    ANSWER_ABORTED,
    ANSWER_ACCEPTED,
    ANSWER_CANCEL_ACCEPTED,
    ANSWER_CANCEL_REJECTED,
    ANSWER_CANCELED,
    ANSWER_FATE_UNKNOWN,
    ANSWER_NO_RESULT,
    ANSWER_NOT_EXECUTED,
    ANSWER_SUCCEEDED,
    ASK_CANCEL,
    GOAL_ID_END,
    WRITER_LINE,
)
from tests.lib.channels import acting_reader
from tests.lib.clock import SteppedClock
from tests.unit.bridge.conftest import MESSAGES

STORE = TypeStore.bundled("jazzy")
TYPE = "example_interfaces/action/Fibonacci"
DOMAIN = 43
WATCHDOG_S = 100.0
CANCELING = ANSWER_ACCEPTED | ANSWER_CANCEL_ACCEPTED
WIDE = {
    part: compute_layout(STORE, f"{TYPE}_{part.word.capitalize()}", Limits(sequence=300)) for part in ACTION
}


def sequence(part: Part, *numbers: int) -> bytes:
    return Codec(WIDE[part], Wire.CDR).encode(WIDE[part].pack({"sequence": list(numbers)}))


def node(name: str) -> MemoryBackend:
    return open_backend(STORE, name, domain=DOMAIN)


class Server(ActionServer):
    """An action in ROS that notes what it is asked, and decides when the test says so."""

    def __init__(self) -> None:
        self.goals: list[tuple[bytes, int]] = []
        self.cancels: list[bytes] = []
        self.node = node("robot")
        super().__init__(self.node, STORE, "/a", TYPE, on_goal=self._on_new, on_cancel=self.cancels.append)

    def _on_new(self, uuid: bytes, goal: bytes) -> None:
        self.goals.append((uuid, struct.unpack("<i", goal[4:])[0]))

    def begin(self, uuid: bytes) -> None:
        assert self.accept(uuid)
        assert self.execute(uuid)

    def leave(self) -> None:
        self.close()
        self.node.close()


class Plc:
    """The PLC's side of the action, one step at a time."""

    def __init__(self, cell: Cell) -> None:
        self.objects = {part: attach(cell.namespace, "/a", write=True, part=part) for part in ACTION}
        self.plan, self.beats = cell.plan, True
        self.writer = self.objects[Part.GOAL].writer(100)
        self.readers = {
            part: acting_reader(self.objects[part], "Task", beat_ms=100)
            for part in (Part.RESULT, Part.FEEDBACK)
        }
        self.caller = Caller(self.objects[Part.GOAL], self.writer, follows_claim=False)
        self.number, self.uuid = 0, b""
        self.answers: list[tuple[int, int]] = []
        self.results: list[list[int]] = []
        self.feedback: list[list[int]] = []
        self.client = b""

    def step(self) -> None:
        """Beat, and take what came for the goal."""
        if not self.beats:
            return
        for user in (self.writer, *self.readers.values()):
            user.beat()
        for part, reader in self.readers.items():
            layout = self.plan.layout(part)
            record = bytearray(layout.size)
            info = reader.latest(record)
            if info is None or info.correlation != self.number:
                continue
            found = list(layout.to_dict(record)["sequence"])
            assert info.client == self.uuid
            if part is Part.FEEDBACK:
                assert info.status == ANSWER_ACCEPTED
                self.feedback.append(found)
            else:
                self.answers.append((info.status, info.reason))
                self.results.append(found)
                self.caller.answer(info)

    def send(self, order: int = 5, uuid: bytes | None = None) -> bytes:
        """Send a goal; return its UUID."""
        low = (self.number & 0xFFFFFFFF) + 1
        generation = self.objects[Part.GOAL].identity.generation
        self.number = self.writer.epoch << 32 | low
        self.uuid = struct.pack("<4I", generation, self.writer.epoch, low, GOAL_ID_END)
        self.answers, self.results, self.feedback = [], [], []
        client = self.uuid if uuid is None else uuid
        self._publish = partial(self.writer.publish, self.plan.goal.pack({"order": order}))
        assert self.caller.call(self._publish, client=client) == self.number
        return self.uuid

    def ask(self, status: int = ASK_CANCEL) -> None:
        self.caller.again(self._publish, status)

    def withdraw(self) -> bool:
        return self.caller.withdraw(self._publish)

    def leave(self) -> None:
        for one in self.objects.values():
            one.close()


class Cell:
    """A bridge with one action whose thread is the test's, a server of it in ROS, and a PLC."""

    def __init__(self, namespace: Namespace, entry: str) -> None:
        self.entry = entry
        self.configure()
        self.namespace, self.clock = namespace, SteppedClock()
        self.server: Server | None = None
        self.plc: Plc | None = None
        self.lives: list[Plc] = []
        self.bridge()

    def configure(self, more: str = "") -> None:
        entry = ", ".join(filter(None, (self.entry, more)))
        (self.plan,) = resolve(
            parse_config(f"actions: {{/a: {{type: {TYPE}, server: ros, {entry}}}}}")
        ).actions

    def bridge(self) -> None:
        """Start a bridge; the one before is gone without a word."""
        context = Context(self.namespace, "cell", bytes(16), "jazzy", clock=self.clock)
        self.ports = CallPorts(context, 1_000_000)
        self.node = node("bridge")
        use = self.ports.make(self.plan)
        assert isinstance(use, CalledGoals)
        self.use = use
        self.use.open()
        self.use.connect(self.node)
        self.ports.add(self.use)
        self.use.begin(self.clock.monotonic_ns())

    def kill(self) -> None:
        """End the bridge so that it can do nothing any more."""
        for channel in self.use._channels.values():
            channel._abandon()  # as in a forked child: claims and words stay
        self.node.close()

    def restart(self) -> None:
        self.kill()
        self.bridge()

    def serve(self) -> Server:
        self.server = Server()
        return self.server

    def attach(self) -> Plc:
        """Start the PLC's program, and let the bridge see it live."""
        if self.plc is not None:
            self.plc.leave()
        self.plc = Plc(self)
        self.lives.append(self.plc)
        self.turn(0.05, 4)
        return self.plc

    def turn(self, seconds: float = 0.006, times: int = 1) -> None:
        """Let time pass: the PLC beats, and the thread of the calls goes round."""
        for _ in range(times):
            if self.plc is not None:
                self.plc.step()
            now = self.clock.advance(seconds)
            _, again = self.ports.take(now)
            for use in again:
                self.ports.remove(use)
                if use.reopen(now):
                    self.ports.add(use)

    def until(self, condition: Callable[[], Any], what: str = "") -> Any:
        """Turn until a condition holds; return its value."""
        end = time.monotonic() + WATCHDOG_S
        while not (found := condition()):
            assert time.monotonic() < end, what
            self.turn()
            time.sleep(0.0005)
        return found

    @property
    def status(self) -> ActionStatus:
        """The state, with each goal in exactly one number."""
        found = self.use.status(self.clock.monotonic_ns())
        assert isinstance(found, ActionStatus)
        ends = found.succeeded + found.aborted + found.canceled + found.unreadable + found.late
        unknown = sum(found.not_executed.values()) + sum(found.fate_unknown.values())
        assert found.received == ends + unknown + found.outstanding
        return found

    def close(self) -> None:
        if self.plc is not None:
            self.plc.leave()
        if self.server is not None:
            self.server.leave()
        self.use.disconnect()
        self.use.close()
        self.node.close()


Make = Callable[..., Cell]


@pytest.fixture
def make(shm_namespace: Namespace) -> Iterator[Make]:
    cells: list[Cell] = []

    def start(entry: str = "") -> Cell:
        cells.append(Cell(shm_namespace, entry))
        return cells[-1]

    yield start
    for cell in cells:
        cell.close()


def asked(cell: Cell, order: int = 5) -> tuple[Server, Plc, bytes]:
    """Have a goal sent that its server has not decided on."""
    server = cell.server or cell.serve()
    plc = cell.plc or cell.attach()
    cell.until(lambda: cell.use._ready, "the server")
    uuid = plc.send(order)
    cell.until(lambda: (uuid, order) in server.goals, "the goal")
    return server, plc, uuid


def begun(cell: Cell) -> tuple[Server, Plc, bytes]:
    """Have a goal sent and accepted."""
    server, plc, uuid = asked(cell)
    server.begin(uuid)
    cell.until(lambda: plc.answers == [(ANSWER_ACCEPTED, 0)], "the acceptance")
    return server, plc, uuid


def ended(cell: Cell) -> tuple[int, int]:
    """Return how the goal has ended, status and reason."""
    plc = cell.plc
    assert plc is not None
    cell.until(lambda: plc.caller.correlation == 0, "the end of the goal")
    return plc.answers[-1]


# -- how a goal goes on


def test_a_goal_its_feedback_and_its_result(make: Make) -> None:
    cell = make()
    server, plc, uuid = begun(cell)
    assert (cell.status.outstanding, cell.status.goal_status) == (1, "executing")
    server.feedback(uuid, sequence(Part.FEEDBACK, 0, 1))
    cell.until(lambda: plc.feedback == [[0, 1]], "feedback")
    server.succeed(uuid, sequence(Part.RESULT, 0, 1, 1, 2))
    assert ended(cell) == (ANSWER_SUCCEEDED, 0)
    assert plc.results[-1] == [0, 1, 1, 2]
    assert (cell.status.succeeded, cell.status.feedback, cell.status.goal_status) == (1, 1, "")
    asked(cell, 6)
    assert cell.status.goal_status == "waiting"
    assert [order for _, order in server.goals] == [5, 6]


@pytest.mark.parametrize(
    ("end", "status", "number"),
    [
        ("reject", (ANSWER_NOT_EXECUTED, Reason.REJECTED), "not_executed"),
        ("abort", (ANSWER_ABORTED, 0), "aborted"),
        ("unknown", (ANSWER_FATE_UNKNOWN, Reason.SERVER_GONE), "fate_unknown"),
    ],
)
def test_other_ends(make: Make, end: str, status: tuple[int, int], number: str) -> None:
    cell = make()
    server, _, uuid = asked(cell) if end == "reject" else begun(cell)
    if end == "reject":
        server.reject(uuid)
    elif end == "abort":
        server.abort(uuid, sequence(Part.RESULT, 7))
    else:
        server.leave()
        cell.serve()  # another process, which does not know the goal
    assert ended(cell) == status
    assert getattr(cell.status, number) in (1, {Reason(status[1]).name.lower(): 1})


def test_without_a_server_a_goal_waits(make: Make) -> None:
    cell = make()
    plc = cell.attach()
    plc.send()
    cell.turn(0.02, 3)
    assert not plc.caller.begun()
    assert cell.status.received == 0
    server = cell.serve()
    cell.until(lambda: server.goals, "the goal")


def test_a_server_that_leaves_before_it_decides(make: Make) -> None:
    cell = make()
    server, _, _ = asked(cell)
    server.leave()
    cell.server = None
    assert ended(cell) == (ANSWER_FATE_UNKNOWN, Reason.SERVER_GONE)


def test_a_goal_of_another_uuid_is_refused(make: Make) -> None:
    cell = make()
    server, plc = cell.serve(), cell.attach()
    cell.until(lambda: cell.use._ready, "the server")
    plc.send(uuid=bytes(16))
    plc.uuid = bytes(16)  # repeated in the answer
    assert ended(cell) == (ANSWER_NOT_EXECUTED, Reason.REJECTED)
    assert server.goals == []


# -- canceling


@pytest.mark.parametrize("agrees", [True, False])
def test_canceling(make: Make, agrees: bool) -> None:
    cell = make()
    server, plc, uuid = begun(cell)
    plc.ask()
    cell.until(lambda: server.cancels == [uuid], "the request to cancel")
    if agrees:
        server.accept_cancel(uuid)
        cell.until(lambda: plc.answers[-1] == (CANCELING, 0), "canceling")
        assert cell.status.goal_status == "canceling"
        server.canceled(uuid, sequence(Part.RESULT, 3))
        assert ended(cell) == (ANSWER_CANCELED, 0)
        assert plc.results[-1] == [3]
        assert cell.status.canceled == 1
        return
    server.reject_cancel(uuid)
    cell.until(lambda: plc.answers[-1] == (ANSWER_ACCEPTED | ANSWER_CANCEL_REJECTED, 0), "the refusal")
    plc.ask(0)
    cell.turn()
    plc.ask()
    cell.until(lambda: server.cancels == [uuid, uuid], "the second request")
    server.succeed(uuid, sequence(Part.RESULT))
    assert ended(cell) == (ANSWER_SUCCEEDED, 0)


def test_a_cancel_before_the_acceptance_is_sent_behind_it(make: Make) -> None:
    cell = make()
    server, plc, uuid = asked(cell)
    plc.ask()
    cell.turn(0.02, 5)
    assert plc.answers == []
    server.begin(uuid)
    cell.until(lambda: server.cancels == [uuid], "the request to cancel")


def test_a_goal_that_is_canceled_before_it_was_taken_is_not_sent(make: Make) -> None:
    cell = make()
    plc = cell.attach()
    plc.send()
    plc.ask()
    server = cell.serve()
    assert ended(cell) == (ANSWER_NOT_EXECUTED, Reason.CALLER_GONE)
    assert server.goals == []


def test_another_client_cancels_the_goal(make: Make) -> None:
    cell = make()
    server, plc, uuid = begun(cell)
    other = node("other")
    cancel = other.client("/a/_action/cancel_goal", "action_msgs/srv/CancelGoal", SERVICES)
    cancel.call(MESSAGES.pack_cancel(uuid), lambda _: None)
    cell.until(lambda: server.cancels, "the request to cancel")
    server.accept_cancel(uuid)
    cell.until(lambda: plc.answers[-1] == (CANCELING, 0), "the status")
    other.close()


def test_a_cancel_that_no_server_answers_is_asked_again(make: Make) -> None:
    """As when its node was away for a while: the robot still moves."""
    cell = make()
    _, plc, uuid = begun(cell)
    refused = [BackendError("ROS009", "closed"), BackendError("ROS009", "closed")]
    asked_: list[bytes] = []
    client: Any = cell.use._endpoint
    cancel = client.cancel

    def fail(goal: bytes) -> None:
        asked_.append(goal)
        if refused:
            raise refused.pop()
        if len(asked_) == 3:
            cell.use.tell(actions.GoalEvent(goal, "not canceled", reply=Reply()))
        else:
            cancel(goal)

    client.cancel = fail
    plc.ask()
    server = cell.server
    assert server is not None
    cell.until(lambda: server.cancels == [uuid], "the request to cancel")
    assert len(asked_) == 4


# -- withdrawn


def test_a_goal_that_is_withdrawn_before_it_was_taken(make: Make) -> None:
    cell = make()
    plc = cell.attach()
    plc.send()
    assert not plc.withdraw()
    server = cell.serve()
    cell.until(lambda: plc.answers, "the answer")
    assert plc.answers == [(ANSWER_NOT_EXECUTED, Reason.CALLER_GONE)]
    assert server.goals == []


@pytest.mark.parametrize("decision", ["accept", "reject"])
def test_a_goal_that_is_withdrawn_before_its_acceptance(make: Make, decision: str) -> None:
    """It may be accepted later, and then it is canceled; the PLC does not wait for that."""
    cell = make()
    server, plc, uuid = asked(cell)
    assert plc.withdraw()
    assert ended(cell) == (ANSWER_FATE_UNKNOWN, Reason.CALLER_GONE)
    if decision == "reject":
        server.reject(uuid)
        cell.until(lambda: not cell.use._goals, "the end of the goal")
        return
    server.begin(uuid)
    cell.until(lambda: server.cancels == [uuid], "the request to cancel")
    server.accept_cancel(uuid)
    cell.until(lambda: not cell.use._goals, "the end of the goal")
    assert len(plc.answers) == 1


def test_a_goal_that_is_withdrawn_after_its_acceptance_is_canceled(make: Make) -> None:
    cell = make()
    server, plc, uuid = begun(cell)
    assert plc.withdraw()
    cell.until(lambda: server.cancels == [uuid], "the request to cancel")
    server.accept_cancel(uuid)
    server.canceled(uuid)
    assert ended(cell) == (ANSWER_CANCELED, 0)


# -- the PLC goes


@pytest.mark.parametrize("when", ["cancel", "keep"])
@pytest.mark.parametrize("again", [True, False])
def test_a_plc_that_goes(make: Make, when: str, again: bool) -> None:
    """Its program starts again, or is silent."""
    cell = make(f"when_plc_down: {when}")
    server, plc, uuid = begun(cell)
    if again:
        plc = cell.attach()
    else:
        plc.beats = False
        cell.turn(0.1, 8)
    if when == "cancel":
        cell.until(lambda: server.cancels == [uuid], "the request to cancel")
        assert cell.status.fate_unknown == {"plc_down": 1}
        return
    if again:
        assert cell.status.fate_unknown == {"plc_down": 1}
        # An answer for the life before completes nothing; the new one has a goal of its own.
        server.succeed(uuid, sequence(Part.RESULT))
        server, plc, second = asked(cell, 6)
        assert second != uuid
        assert plc.answers == []
    else:
        plc.beats = True
        server.succeed(uuid, sequence(Part.RESULT, 1))
        assert ended(cell) == (ANSWER_SUCCEEDED, 0)
    assert server.cancels == []


def test_what_a_dead_plc_asked_for_is_never_sent(make: Make) -> None:
    cell = make()
    plc = cell.attach()
    plc.send()
    plc.beats = False
    cell.turn(0.1, 8)
    server = cell.serve()
    cell.until(lambda: cell.use._ready, "the server")
    cell.turn(0.1, 8)
    cell.attach()
    _, _, _ = asked(cell, 6)
    assert [order for _, order in server.goals] == [6]


# -- the bridge goes


def test_a_bridge_that_was_killed_adopts_the_goal(make: Make) -> None:
    cell = make()
    server, plc, uuid = begun(cell)
    cell.restart()
    cell.until(lambda: len(plc.answers) == 2, "the state, told again")
    server.feedback(uuid, sequence(Part.FEEDBACK, 1))
    cell.until(lambda: plc.feedback == [[1]], "feedback")
    server.succeed(uuid, sequence(Part.RESULT, 9))
    assert ended(cell) == (ANSWER_SUCCEEDED, 0)
    assert plc.results[-1] == [9]
    assert (cell.status.received, cell.status.succeeded) == (1, 1)
    assert len(server.goals) == 1


def test_a_goal_that_was_sent_and_not_told_of_is_asked_for(make: Make) -> None:
    """The bridge was killed between the acceptance and its message: the next one never sends it again."""
    cell = make()
    server, plc, uuid = asked(cell)
    cell.kill()
    server.begin(uuid)
    cell.bridge()
    cell.until(lambda: plc.answers == [(ANSWER_ACCEPTED, 0)], "the acceptance")
    server.succeed(uuid, sequence(Part.RESULT))
    assert ended(cell) == (ANSWER_SUCCEEDED, 0)
    assert len(server.goals) == 1


def test_a_bridge_that_was_killed_between_taking_and_sending(make: Make) -> None:
    cell = make()
    server, plc = cell.serve(), cell.attach()
    cell.until(lambda: cell.use._ready, "the server")
    client: Any = cell.use._endpoint
    client.send = lambda *_: True  # and no byte leaves
    plc.send()
    cell.turn(0.006, 3)
    assert plc.caller.begun()
    cell.restart()
    assert ended(cell) == (ANSWER_FATE_UNKNOWN, Reason.BRIDGE_RESTARTED)
    assert server.goals == []


def test_a_goal_that_is_accepted_after_a_restart_goes_on(make: Make) -> None:
    """The server tells its decision to the bridge that has gone alone: the next one keeps asking."""
    cell = make()
    server, plc, uuid = asked(cell)
    cell.restart()
    cell.until(lambda: cell.use._goals[uuid].unknown_ns, "an answer of the server's")
    assert plc.answers == []
    server.begin(uuid)
    cell.until(lambda: plc.answers == [(ANSWER_ACCEPTED, 0)], "the acceptance")
    server.succeed(uuid, sequence(Part.RESULT, 7))
    assert ended(cell) == (ANSWER_SUCCEEDED, 0)
    assert (cell.status.received, cell.status.succeeded, len(server.goals)) == (1, 1, 1)
    assert server.cancels == []


@pytest.mark.parametrize("how", ["late", "withdrawn", "withdrawn before", "new life", "kept", "canceled"])
@pytest.mark.parametrize("again", [False, True])
def test_a_goal_that_is_accepted_long_after_a_restart(make: Make, how: str, again: bool) -> None:
    """The PLC does not wait for it any more: it is canceled as soon as it appears, by any later bridge."""
    cell = make("when_plc_down: keep" if how == "kept" else "")
    server, plc, uuid = asked(cell)
    cell.kill()
    if how == "withdrawn before":
        assert plc.withdraw()
    cell.bridge()
    if how != "withdrawn before":
        cell.until(lambda: cell.use._goals[uuid].unknown_ns, "an answer of the server's")
    if how == "withdrawn":
        assert plc.withdraw()
    elif how == "canceled":
        plc.ask()
    if how in ("new life", "kept"):
        cell.attach()
    else:
        why = Reason.CALLER_GONE if how.startswith("withdrawn") else Reason.BRIDGE_RESTARTED
        assert ended(cell) == (ANSWER_FATE_UNKNOWN, why)
    cell.turn(0.006, 3)
    assert cell.status.received == 1
    if again:
        cell.restart()
        cell.until(lambda: cell.use._ready, "the server")
    server.begin(uuid)
    if how == "kept":
        cell.turn(0.2, 5)
        assert (cell.use._goals, server.cancels) == ({}, [])
        return
    cell.until(lambda: server.cancels, "the request to cancel")
    server.accept_cancel(uuid)
    server.canceled(uuid)
    cell.until(lambda: not cell.use._goals, "the end of the goal")


def test_an_answer_that_is_older_than_the_status(make: Make) -> None:
    """The server did not know the goal before it has accepted it, and is heard behind the status."""
    cell = make()
    server, plc, uuid = asked(cell)
    cell.restart()
    cell.until(lambda: cell.use._goals[uuid].unknown_ns, "an answer of the server's")
    cell.use.tell(actions.GoalEvent(uuid, "status", status=GoalStatus.EXECUTING))
    cell.use.tell(actions.GoalEvent(uuid, "result", status=GoalStatus.UNKNOWN))
    server.begin(uuid)
    cell.turn()
    server.succeed(uuid, sequence(Part.RESULT, 7))
    assert ended(cell) == (ANSWER_SUCCEEDED, 0)
    assert plc.results[-1] == [7]


def test_a_refusal_that_is_older_than_the_status(make: Make) -> None:
    """The server did not know the goal that it was to cancel, and is heard behind the status."""
    cell = make()
    server, plc, uuid = asked(cell)
    cell.kill()
    assert plc.withdraw()
    cell.bridge()
    assert ended(cell) == (ANSWER_FATE_UNKNOWN, Reason.CALLER_GONE)
    unknown = Reply(MESSAGES.pack_canceling(goals.CancelCode.UNKNOWN_GOAL_ID, []))
    cell.use.tell(actions.GoalEvent(uuid, "status", status=GoalStatus.EXECUTING))
    cell.use.tell(actions.GoalEvent(uuid, "not canceled", reply=unknown))
    server.begin(uuid)
    cell.until(lambda: server.cancels, "the request to cancel")


def test_a_goal_that_never_appears_is_forgotten(make: Make) -> None:
    cell = make()
    asked(cell)
    cell.restart()
    assert ended(cell) == (ANSWER_FATE_UNKNOWN, Reason.BRIDGE_RESTARTED)
    cell.until(lambda: [cell.turn(1.0), not cell.use._goals][1], "the end of the goal")
    assert cell.status.fate_unknown == {"bridge_restarted": 1}


@pytest.mark.parametrize("how", ["lives", "new life", "kept", "ended"])
def test_limits_that_change_without_a_bridge(make: Make, how: str) -> None:
    """Other objects take the place of the goal's: it is canceled, or left alone as after another start."""
    cell = make("when_plc_down: keep" if how == "kept" else "")
    server, plc, uuid = begun(cell)
    if how == "ended":
        server.succeed(uuid, sequence(Part.RESULT, 1))
        ended(cell)
    cell.kill()
    if how in ("new life", "kept"):
        plc.objects[Part.GOAL].writer(100)
    cell.plc = None
    cell.configure("limits: {result.sequence: 9}")
    cell.bridge()
    cell.until(lambda: cell.use._ready, "the server")
    if how in ("kept", "ended"):
        assert cell.use._goals == {}
        return
    cell.until(lambda: server.cancels == [uuid], "the request to cancel")
    assert (cell.status.received, cell.status.outstanding) == (0, 0)


@pytest.mark.parametrize("when", ["cancel", "keep"])
def test_a_bridge_that_comes_back_to_another_life_of_the_plc(make: Make, when: str) -> None:
    cell = make(f"when_plc_down: {when}")
    server, _, uuid = begun(cell)
    cell.kill()
    assert cell.plc is not None
    cell.plc.leave()
    cell.plc = None
    cell.bridge()
    plc = cell.attach()
    second = asked(cell, 6)[2]
    if when == "cancel":
        cell.until(lambda: server.cancels == [uuid], "the request to cancel")
    server.begin(second)
    cell.until(lambda: plc.answers == [(ANSWER_ACCEPTED, 0)], "the acceptance")
    assert server.cancels == ([uuid] if when == "cancel" else [])
    assert cell.status.received == 1


def test_a_cancel_that_a_killed_bridge_had_taken_is_not_forgotten(make: Make) -> None:
    cell = make()
    server, plc, uuid = begun(cell)
    client: Any = cell.use._endpoint
    client.cancel = lambda _: None
    plc.ask()
    cell.turn(0.006, 3)
    cell.restart()
    cell.until(lambda: server.cancels == [uuid], "the request to cancel")


def test_a_bridge_that_stops_leaves_the_goal_to_the_next_one(make: Make) -> None:
    cell = make()
    server, _, uuid = begun(cell)
    cell.use.finish(cell.clock.monotonic_ns())
    assert cell.status.outstanding == 1
    cell.use.disconnect()
    cell.use.close()
    cell.node.close()
    cell.bridge()
    server.succeed(uuid, sequence(Part.RESULT, 2))
    assert ended(cell) == (ANSWER_SUCCEEDED, 0)
    assert server.cancels == []


def test_an_action_that_leaves_the_configuration(make: Make) -> None:
    cell = make()
    server, plc, uuid = begun(cell)
    cell.use.give_up(cell.clock.monotonic_ns())
    plc.step()
    assert plc.answers[-1] == (ANSWER_FATE_UNKNOWN, Reason.BRIDGE_RESTARTED)
    cell.until(lambda: server.cancels == [uuid], "the request to cancel")


@pytest.mark.parametrize("replaced", [False, True])
def test_objects_that_are_opened_again(make: Make, replaced: bool) -> None:
    """The goal goes on with the same objects; with others its end cannot be told, and it is canceled."""
    cell = make()
    server, plc, uuid = begun(cell)
    if replaced:
        cell.namespace.path("/a", Part.GOAL).unlink()
    else:
        cell.use._channels[Part.RESULT].region.store(WRITER_LINE["writer_epoch"], 12345)
    now = cell.clock.monotonic_ns()
    if replaced:
        plc.beats = False
        assert cell.use.check(now)
        cell.ports.remove(cell.use)
        assert cell.use.reopen(now)
        cell.ports.add(cell.use)
        cell.until(lambda: server.cancels == [uuid], "the request to cancel")
        assert cell.status.fate_unknown == {"bridge_restarted": 1}
        return
    server.succeed(uuid, sequence(Part.RESULT, 4))  # which cannot be told at first
    assert ended(cell) == (ANSWER_SUCCEEDED, 0)
    assert plc.results[-1] == [4]
    assert (cell.status.received, cell.status.succeeded) == (1, 1)


@pytest.mark.parametrize("stops", [True, False])
@pytest.mark.parametrize("how", ["silent", "withdrawn"])
def test_a_cancel_that_did_not_reach_the_server_is_left_to_the_next_bridge(
    make: Make, how: str, stops: bool
) -> None:
    """The PLC has its answer; without this the robot would move on."""
    cell = make("when_plc_down: cancel" if how == "silent" else "when_plc_down: keep")
    server, plc, uuid = begun(cell) if how == "silent" else asked(cell)
    client: Any = cell.use._endpoint
    client.cancel = lambda _: None  # and no byte leaves
    if how == "silent":
        plc.beats = False
    else:
        assert plc.withdraw()
    cell.until(lambda: cell.use._open_call is None, "the end of the call")
    if how == "withdrawn":
        server.begin(uuid)
    if stops:
        cell.use.finish(cell.clock.monotonic_ns())
        cell.use.disconnect()
        cell.use.close()
        cell.node.close()
    else:
        cell.kill()
    assert server.cancels == []
    cell.bridge()
    cell.until(lambda: server.cancels == [uuid], "the request to cancel")


def test_a_program_that_starts_again_while_the_objects_are_opened_again(make: Make) -> None:
    cell = make()
    server, plc, uuid = begun(cell)
    plc.leave()
    cell.plc = Plc(cell)
    cell.use._channels[Part.RESULT].region.store(WRITER_LINE["writer_epoch"], 12345)
    cell.until(lambda: server.cancels == [uuid], "the request to cancel")
    assert cell.status.fate_unknown == {"bridge_restarted": 1}


# -- the server goes, or says what it must not


def test_a_server_that_is_gone_for_a_while(make: Make) -> None:
    """Nothing is asked while it is away; it is asked again, ever more rarely."""
    cell = make()
    server, plc, uuid = begun(cell)
    server.leave()
    cell.until(lambda: not cell.use._ready, "the server's end")
    cell.turn(0.2, 5)
    assert cell.status.outstanding == 1
    assert "requesting it again" in cell.status.reason
    again = cell.serve()
    again.adopt(uuid, 1, GoalStatus.EXECUTING)
    again.succeed(uuid, sequence(Part.RESULT, 8))
    assert ended(cell) == (ANSWER_SUCCEEDED, 0)
    assert plc.results[-1] == [8]


@pytest.mark.parametrize("numbers", [range(65), None])
def test_a_result_that_the_plc_cannot_take(make: Make, numbers: Any) -> None:
    """Too large for the record, or bytes that are no result."""
    cell = make()
    server, plc, uuid = begun(cell)
    if numbers is None:
        cell.use.tell(actions.GoalEvent(uuid, "result", b"\0\1\0\0\xff\xff", GoalStatus.SUCCEEDED))
    else:
        server.succeed(uuid, sequence(Part.RESULT, *numbers))
    assert ended(cell)[0] == ANSWER_SUCCEEDED | ANSWER_NO_RESULT
    assert plc.results[-1] == []
    assert cell.status.unreadable == 1


def test_a_result_of_a_status_that_is_no_end(make: Make) -> None:
    cell = make()
    _, _, uuid = begun(cell)
    for _ in range(2):  # one answer may be older than the acceptance
        cell.use.tell(actions.GoalEvent(uuid, "result", sequence(Part.RESULT), GoalStatus.EXECUTING))
    assert ended(cell)[0] == ANSWER_FATE_UNKNOWN


def test_feedback_that_cannot_be_read_or_comes_for_another_goal(make: Make) -> None:
    cell = make()
    server, plc, uuid = begun(cell)
    other = node("other")
    feedback = other.advertise("/a/_action/feedback", f"{TYPE}_FeedbackMessage", Qos())
    for payload in (
        b"\0\1\0\0",
        wire.wrap(uuid, b"\0\1\0\0\xff\xff\xff\xff"),
        wire.wrap(bytes(16), sequence(Part.FEEDBACK, 1)),
        wire.wrap(uuid, sequence(Part.FEEDBACK, *range(65))),
        wire.wrap(uuid, sequence(Part.FEEDBACK, 2)),
    ):
        feedback.write(payload)
    cell.until(lambda: plc.feedback, "feedback")
    assert plc.feedback == [[2]]
    assert (cell.status.feedback, cell.status.code) == (1, "SHM142")
    server.succeed(uuid, sequence(Part.RESULT))
    assert ended(cell) == (ANSWER_SUCCEEDED, 0)
    feedback.write(wire.wrap(uuid, sequence(Part.FEEDBACK, 3)))
    asked(cell, 6)
    assert plc.feedback == []
    other.close()


@pytest.mark.parametrize("error", [BackendError("ROS009", "closed"), RuntimeError("no more threads"), None])
def test_a_goal_that_cannot_be_sent(make: Make, error: Exception | None) -> None:
    cell = make()
    cell.serve()
    plc = cell.attach()
    cell.until(lambda: cell.use._ready, "the server")

    def refuse(*_: Any) -> bool:
        if error is not None:
            raise error
        return False

    client: Any = cell.use._endpoint
    client.send = refuse
    plc.send()
    refused = isinstance(error, BackendError)
    assert ended(cell)[0] == (ANSWER_NOT_EXECUTED if refused else ANSWER_FATE_UNKNOWN)


def test_goals_that_are_left_are_bounded(make: Make, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("rosplc.bridge.called._MOST_LEFT", 2)
    cell = make()
    server = cell.serve()
    for order in range(4):
        _, plc, _ = asked(cell, order)
        assert plc.withdraw()
        ended(cell)
    assert len(cell.use._goals) == 2
    assert len(server.goals) == 4


def test_a_flood_of_feedback_holds_nothing_up(make: Make, monkeypatch: pytest.MonkeyPatch) -> None:
    """A turn ends, whatever comes meanwhile, and of what is overtaken little is passed on."""
    cell = make()
    server, _, uuid = begun(cell)
    monkeypatch.setattr("rosplc.bridge.called._MOST_WAITING", 3)
    pass_on, passed = cell.use._pass_on, []
    flood = (actions.GoalEvent(uuid, "feedback", payload=sequence(Part.FEEDBACK, 1)),)

    def flooded(*arguments: Any) -> None:
        passed.append(arguments)
        pass_on(*arguments)
        if len(passed) < 100:
            cell.use.events.append(flood)

    monkeypatch.setattr(cell.use, "_pass_on", flooded)
    cell.use.events.extend([flood] * 10)
    cell.turn()
    assert 1 <= len(passed) <= 3
    assert cell.status.feedback == len(passed)
    monkeypatch.setattr(cell.use, "_pass_on", pass_on)
    server.succeed(uuid, sequence(Part.RESULT))
    assert ended(cell) == (ANSWER_SUCCEEDED, 0)
