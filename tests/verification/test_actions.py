"""The blocks of actions, executed: every line of the tables in docs/reference/blocks."""

from __future__ import annotations

import struct
from collections.abc import Iterator

import pytest

from rosplc.reasons import Reason
from rosplc.shm import constants as spec
from rosplc.shm.constants import READER_LINE, ErrorNumber, reader_line
from tests.verification.call_cell import ActionCaller, ActionServer, CallCell, made_cell
from tests.verification.plc_cell import needs_armhf
from tests.verification.test_services import ABORTED, BUSY, CALL, DELAYED, DONE, ENDS, ERROR, IDLE

pytestmark = pytest.mark.verifies("call-blocks", own="translated Structured Text, 64 and 32 bits; SIGKILL")

CANCEL, PREEMPT, WITHDRAWN = spec.ASK_CANCEL, spec.ASK_PREEMPT, spec.ASK_WITHDRAWN
UNKNOWN, EXECUTING, CANCELING, SUCCEEDED, CANCELED, ABORTED_GOAL = 0, 2, 3, 4, 5, 6


@pytest.fixture(
    params=["fences", DELAYED, "virtual", "C11", "C++17", pytest.param("armhf", marks=needs_armhf)]
)
def cell(request: pytest.FixtureRequest) -> Iterator[CallCell]:
    with made_cell(request.param) as made:
        yield made


@pytest.fixture(params=["fences", DELAYED])
def plc(request: pytest.FixtureRequest) -> Iterator[CallCell]:
    """A cell that only a PLC makes: with online changes."""
    with made_cell(request.param) as made:
        yield made


# ---- the PLC sends goals


def sent(cell: CallCell, *, accepted: bool = True, **pins: object) -> tuple[ActionServer, int]:
    """Return a server that has a goal of the PLC, and the goal's number."""
    server = ActionServer(cell)
    cell.until(lambda: server.get("xServer"))
    server.set(**{"goal.data": 7, "xExecute": True, **pins})
    asked = cell.until(server.take)
    assert (asked[0], asked[2]) == (CALL, 7)
    if accepted:
        assert server.requests.begin()
        server.answer(asked[1], spec.ANSWER_ACCEPTED)
        cell.until(lambda: server.get("xActive"))
    return server, asked[1]


def why(server: ActionServer) -> tuple[int, int]:
    return server.get("eError", "eReason")


def test_a_goal(cell: CallCell) -> None:
    """Accepted, followed by its feedback, and reached; its UUID follows from what its slot says."""
    server, number = sent(cell, accepted=False)
    words = (server.channels[0].generation, number >> 32, number & 0xFFFFFFFF, spec.GOAL_ID_END)
    assert server.client == struct.pack("<4I", *words)
    assert server.get("xActive", "eStatus") == (False, UNKNOWN)
    server.answer(number, spec.ANSWER_ACCEPTED)
    cell.until(lambda: server.get("xActive"))
    assert server.get(*ENDS) == BUSY
    assert server.get("eStatus") == EXECUTING
    for value in range(3):
        server.report(number, value)
        cell.until(lambda: server.get("xNewFeedback"))
        assert server.get("feedback.data") == value
        cell.scan()
        assert not server.get("xNewFeedback")
    server.report(number - 1, 99)
    cell.scan(5)
    assert server.get("feedback.data") == 2
    server.answer(number, spec.ANSWER_SUCCEEDED, 42)
    cell.until(lambda: server.get(*ENDS) == DONE)
    assert server.get("result.data", "xActive", "eStatus", "eError") == (42, False, SUCCEEDED, 0)
    server.set(xExecute=False)
    cell.scan()
    assert server.get(*ENDS) == IDLE


@pytest.mark.parametrize(
    ("status", "ends", "goal", "number", "result"),
    [
        (spec.ANSWER_CANCELED, ABORTED, CANCELED, ErrorNumber.GOAL_CANCELED, 5),
        (spec.ANSWER_ABORTED, ERROR, ABORTED_GOAL, ErrorNumber.GOAL_ABORTED, 5),
        (spec.ANSWER_SUCCEEDED + spec.ANSWER_NO_RESULT, ERROR, SUCCEEDED, ErrorNumber.UNREADABLE, 0),
        (spec.ANSWER_CANCELED + spec.ANSWER_NO_RESULT, ABORTED, CANCELED, ErrorNumber.GOAL_CANCELED, 0),
        (spec.ANSWER_FATE_UNKNOWN, ERROR, EXECUTING, ErrorNumber.FATE_UNKNOWN, 0),
        (spec.ANSWER_NOT_EXECUTED, ERROR, EXECUTING, ErrorNumber.NOT_EXECUTED, 0),
        (spec.ANSWER_DONE, ERROR, EXECUTING, ErrorNumber.FATE_UNKNOWN, 0),  # of a service
    ],
)
def test_the_ends_of_a_goal(
    cell: CallCell, status: int, ends: tuple[bool, ...], goal: int, number: int, result: int
) -> None:
    """What the server reports is what the pins say; the result of a goal that failed is shown as well."""
    server, correlation = sent(cell)
    server.answer(correlation, spec.ANSWER_ABORTED + 1, 5)  # no answer of this format
    cell.scan(5)
    assert server.get("xBusy", "result.data") == (True, 0)
    server.answer(correlation, status, 5)
    cell.until(lambda: not server.get("xBusy"))
    assert server.get(*ENDS) == ends
    assert server.get("eStatus", "eError", "result.data", "xActive") == (goal, number, result, False)


def test_a_rejected_goal(cell: CallCell) -> None:
    """A goal that the server rejects was not executed."""
    server, number = sent(cell, accepted=False)
    server.answer(number, spec.ANSWER_NOT_EXECUTED, reason=Reason.REJECTED)
    cell.until(lambda: server.get(*ENDS) == ERROR)
    assert why(server) == (ErrorNumber.NOT_EXECUTED, Reason.REJECTED)


def test_cancel(cell: CallCell) -> None:
    """The goal stays in hand until the server has ended it."""
    server, number = sent(cell)
    server.set(xCancel=True)
    asked = cell.until(server.take)
    assert asked[:2] == (CALL + CANCEL, number)
    cell.scan(10)
    assert server.get(*ENDS) == BUSY
    server.answer(number, spec.ANSWER_ACCEPTED + spec.ANSWER_CANCEL_ACCEPTED)
    cell.until(lambda: server.get("eStatus") == CANCELING)
    server.set(xCancel=False)
    cell.scan(5)
    assert server.take() is None
    server.answer(number, spec.ANSWER_CANCELED + spec.ANSWER_CANCEL_ACCEPTED, 3)
    cell.until(lambda: server.get(*ENDS) == ABORTED)
    assert server.get("eError", "result.data") == (ErrorNumber.GOAL_CANCELED, 3)


def test_a_rejected_cancel(cell: CallCell) -> None:
    """The goal goes on; xCancel that falls and rises asks again."""
    server, number = sent(cell)
    server.set(xCancel=True)
    cell.until(server.take)
    server.answer(number, spec.ANSWER_ACCEPTED + spec.ANSWER_CANCEL_REJECTED)
    cell.until(lambda: server.get("xCancelRejected"))
    assert server.get(*ENDS) == BUSY
    assert server.get("eStatus") == EXECUTING
    server.set(xCancel=False)
    assert cell.until(server.take)[:2] == (CALL, number)
    assert not server.get("xCancelRejected")
    server.set(xCancel=True)
    assert cell.until(server.take)[:2] == (CALL + CANCEL, number)
    server.answer(number, spec.ANSWER_SUCCEEDED, 1)
    cell.until(lambda: server.get(*ENDS) == DONE)


def test_cancel_with_execute_sends_nothing(cell: CallCell) -> None:
    """A goal that is canceled before it was sent has not been executed."""
    server = ActionServer(cell)
    cell.until(lambda: server.get("xServer"))
    server.set(xExecute=True, xCancel=True)
    cell.scan()
    assert server.get(*ENDS) == ABORTED
    assert why(server)[0] == ErrorNumber.NOT_EXECUTED
    cell.scan(10)
    assert server.take() is None


def test_time_out_cancels(cell: CallCell) -> None:
    """The goal is canceled and its fate unknown; the next goal waits for its end."""
    server, number = sent(cell, tTimeout=200)
    cell.until(lambda: server.get(*ENDS) == ERROR)
    assert why(server) == (ErrorNumber.FATE_UNKNOWN, Reason.TIME_OUT)
    assert not server.get("xActive")
    assert cell.until(server.take)[:2] == (CALL + CANCEL, number)
    server.set(xExecute=False, tTimeout=0)
    cell.scan()
    server.set(**{"xExecute": True, "goal.data": 8})
    cell.scan(20)
    assert server.get(*ENDS) == BUSY
    assert server.take() is None
    server.answer(number, spec.ANSWER_ACCEPTED + spec.ANSWER_CANCEL_ACCEPTED)
    cell.scan(10)
    assert server.take() is None
    server.answer(number, spec.ANSWER_CANCELED, 9)
    asked = cell.until(server.take)
    assert (asked[0], asked[1], asked[2]) == (CALL, number + 1, 8)
    assert server.get("result.data") == 0
    server.answer(asked[1], spec.ANSWER_SUCCEEDED, 10)
    cell.until(lambda: server.get(*ENDS) == DONE)


@pytest.mark.parametrize("taken", [False, True])
def test_time_out_before_acceptance(cell: CallCell, taken: bool) -> None:
    """A goal that was not accepted is withdrawn: not executed if nobody has taken it."""
    server = ActionServer(cell)
    cell.until(lambda: server.get("xServer"))
    server.set(xExecute=True, tTimeout=100)
    asked = cell.until(server.take) if taken else None
    cell.until(lambda: server.get(*ENDS) == ERROR)
    number = ErrorNumber.FATE_UNKNOWN if taken else ErrorNumber.NOT_EXECUTED
    assert why(server) == (number, Reason.TIME_OUT)
    withdrawn = cell.until(server.take)
    assert withdrawn[0] == CALL + CANCEL + WITHDRAWN
    server.set(xExecute=False, tTimeout=0)
    cell.scan()
    server.set(xExecute=True)
    if asked:
        cell.scan(20)
        assert server.take() is None
        server.answer(asked[1], spec.ANSWER_NOT_EXECUTED)
    assert cell.until(server.take)[0] == CALL


def test_a_silent_bridge_keeps_the_goal(cell: CallCell) -> None:
    """The goal of a bridge that is killed goes on; the one that adopts the objects ends it."""
    server, number = sent(cell)
    server.close()
    cell.scan(400, beats=False)
    assert server.get(*ENDS) == BUSY
    assert server.get("xPeerAlive", "xActive") == (False, True)
    again = ActionServer(cell)
    cell.until(lambda: again.get("xPeerAlive"))
    again.answer(number, spec.ANSWER_SUCCEEDED, 6)
    cell.until(lambda: again.get(*ENDS) == DONE)
    assert again.get("result.data") == 6


def test_replaced_objects_end_the_goal(cell: CallCell) -> None:
    """The fate of a goal in retired objects is unknown."""
    server, _ = sent(cell)
    server.retire()
    again = ActionServer(cell)
    cell.until(lambda: again.get(*ENDS) == ERROR)
    assert why(again) == (ErrorNumber.FATE_UNKNOWN, Reason.BRIDGE_RESTARTED)
    again.set(xExecute=False)
    cell.until(lambda: again.get("xServer"))
    again.set(xExecute=True)
    assert cell.until(again.take)[0] == CALL


def test_online_change_of_a_client(plc: CallCell) -> None:
    """An online change keeps the goal."""
    server, _ = sent(plc)
    plc.machine.online_change()
    plc.scan(5)
    assert server.get("xActive", "eStatus") == (True, EXECUTING)
    assert server.take() is None


def test_stop_and_run_of_a_client(cell: CallCell) -> None:
    """After STOP → RUN answers to the goal complete nothing."""
    server, number = sent(cell)
    cell.machine.stop()
    cell.machine.start()
    cell.until(lambda: server.get("xServer"))
    assert server.get(*ENDS) == IDLE
    server.answer(number, spec.ANSWER_SUCCEEDED, 6)
    cell.scan(5)
    assert server.get(*ENDS) == IDLE
    assert server.get("eStatus", "udiLate") == (UNKNOWN, 1)


# ---- the PLC is the server


def offered(cell: CallCell, *, accepted: bool = True) -> tuple[ActionCaller, int]:
    """Return a caller whose goal the PLC has, and the goal's number."""
    caller = ActionCaller(cell)
    cell.until(lambda: caller.get("xAttached", "xPeerAlive") == (True, True))
    number = caller.call(11)
    cell.until(lambda: caller.get("xGoal"))
    assert caller.get("goal.data", "xActive", "udiCalls") == (11, False, 1)
    if accepted:
        caller.set(xAccept=True)
        assert cell.until(caller.answer)[:2] == (spec.ANSWER_ACCEPTED, number)
        caller.set(xAccept=False)
        cell.scan()
        assert caller.get("xGoal", "xActive") == (False, True)
    return caller, number


def end(cell: CallCell, caller: ActionCaller, pin: str, value: int = 0) -> tuple[int, int, int, int]:
    """End the goal in hand by a pin, and return what the caller is told."""
    caller.set(**{"result.data": value, pin: True})
    answer: tuple[int, int, int, int] = cell.until(caller.answer)
    caller.set(**{pin: False})
    cell.scan()
    return answer


def test_a_goal_is_carried_out(cell: CallCell) -> None:
    """Shown, accepted, followed by feedback while xSendFeedback, and reached."""
    caller, number = offered(cell, accepted=False)
    caller.set(**{"xSendFeedback": True, "feedback.data": 1})
    cell.scan(10)
    assert caller.reported() is None
    assert caller.get("xGoal")
    caller.set(xAccept=True)
    assert cell.until(caller.answer) == (spec.ANSWER_ACCEPTED, number, 0, 0)
    for value in range(2, 5):
        caller.set(**{"feedback.data": value})
        cell.until(lambda value=value: caller.reported() == (spec.ANSWER_ACCEPTED, number, value))
    assert caller.get("xGoal", "xActive") == (False, True)
    assert end(cell, caller, "xSucceed", 77) == (spec.ANSWER_SUCCEEDED, number, 77, 0)
    assert caller.get("xGoal", "xActive", "udiError") == (False, False, 0)
    caller.reported()
    cell.scan(10)
    assert caller.reported() is None
    assert caller.answer() is None


def test_a_goal_is_rejected(cell: CallCell) -> None:
    """A rejected goal ends, and the next is shown."""
    caller, number = offered(cell, accepted=False)
    assert end(cell, caller, "xReject") == (spec.ANSWER_NOT_EXECUTED, number, 0, Reason.REJECTED)
    caller.call(12)
    cell.until(lambda: caller.get("xGoal"))
    assert caller.get("goal.data") == 12


def test_a_goal_is_aborted(cell: CallCell) -> None:
    """The program tells that it failed, with a result."""
    caller, number = offered(cell)
    assert end(cell, caller, "xAbort", 5) == (spec.ANSWER_ABORTED, number, 5, 0)


def test_a_goal_is_canceled(cell: CallCell) -> None:
    """The program agrees first, and then ends the goal."""
    caller, number = offered(cell)
    caller.ask(CALL + CANCEL)
    cell.until(lambda: caller.get("xCancelRequested"))
    caller.set(xAcceptCancel=True)
    status = spec.ANSWER_ACCEPTED + spec.ANSWER_CANCEL_ACCEPTED
    assert cell.until(caller.answer) == (status, number, 0, 0)
    assert caller.get("xCancelRequested", "xCanceling", "xActive") == (False, True, True)
    status = spec.ANSWER_CANCELED + spec.ANSWER_CANCEL_ACCEPTED
    assert end(cell, caller, "xCanceled", 4) == (status, number, 4, 0)
    assert not caller.get("xCanceling")


def test_a_cancel_is_rejected(cell: CallCell) -> None:
    """The goal goes on; the same message with another bit does not ask again, a repeated one does."""
    caller, number = offered(cell)
    caller.ask(CALL + CANCEL)
    cell.until(lambda: caller.get("xCancelRequested"))
    caller.set(xRejectCancel=True)
    assert cell.until(caller.answer)[0] == spec.ANSWER_ACCEPTED + spec.ANSWER_CANCEL_REJECTED
    caller.set(xRejectCancel=False)
    caller.ask(CALL + CANCEL + PREEMPT)
    cell.until(lambda: caller.get("xPreempt"))
    assert caller.get("xCancelRequested", "xActive") == (False, True)
    cell.until(
        lambda: caller.channels[0].region.word(reader_line(0) + READER_LINE["taken"]) == caller.requests.head
    )
    caller.ask(CALL + CANCEL + PREEMPT)
    cell.until(lambda: caller.get("xCancelRequested"))
    caller.ask(CALL)
    cell.until(lambda: not caller.get("xCancelRequested"))
    assert not caller.get("xPreempt")
    assert end(cell, caller, "xSucceed", 4)[:2] == (
        spec.ANSWER_SUCCEEDED + spec.ANSWER_CANCEL_REJECTED,
        number,
    )


def test_a_goal_withdrawn_before_it_was_accepted(cell: CallCell) -> None:
    """The block rejects it: accepting is the program's alone, and comes too late then."""
    caller, number = offered(cell, accepted=False)
    assert caller.withdraw() is True
    assert cell.until(caller.answer) == (spec.ANSWER_NOT_EXECUTED, number, 0, Reason.CALLER_GONE)
    assert caller.get("xGoal", "xActive") == (False, False)
    caller.set(xAccept=True)
    cell.scan()
    assert caller.get("udiError", "xActive") == (ErrorNumber.ILLEGAL_STEP, False)
    assert caller.answer() is None


def test_preempted(cell: CallCell) -> None:
    """Another goal waits: the program ends the old one, and gets the new one then."""
    caller, number = offered(cell)
    caller.ask(CALL + PREEMPT)
    cell.until(lambda: caller.get("xPreempt"))
    caller.ask(CALL + spec.ASK_ACCEPTED)  # it waits no longer
    cell.until(lambda: not caller.get("xPreempt"))
    assert caller.get("xActive", "xCancelRequested") == (True, False)
    caller.ask(CALL + PREEMPT)
    cell.until(lambda: caller.get("xPreempt"))
    assert caller.get("xActive")
    assert end(cell, caller, "xAbort")[:2] == (spec.ANSWER_ABORTED, number)
    caller.call(12)
    cell.until(lambda: caller.get("xGoal"))
    assert caller.get("goal.data", "xPreempt") == (12, False)


STEPS = ("xAccept", "xReject", "xAcceptCancel", "xRejectCancel", "xSucceed", "xAbort", "xCanceled")
LEGAL = {
    "none": (),
    "offered": ("xAccept", "xReject"),
    "active": ("xSucceed", "xAbort"),
    "asked": ("xSucceed", "xAbort", "xAcceptCancel", "xRejectCancel"),
    "canceling": ("xSucceed", "xAbort", "xCanceled"),
}


@pytest.mark.parametrize("state", LEGAL)
def test_illegal_steps(cell: CallCell, state: str) -> None:
    """Every step that a state does not allow is refused with 145 and changes nothing."""
    caller, _ = offered(cell, accepted=state not in ("none", "offered"))
    if state == "none":
        end(cell, caller, "xReject")
    if state in ("asked", "canceling"):
        caller.ask(CALL + CANCEL)
        cell.until(lambda: caller.get("xCancelRequested"))
    if state == "canceling":
        caller.set(xAcceptCancel=True)
        cell.until(caller.answer)
        caller.set(xAcceptCancel=False)
        cell.scan()
    pins = ("xGoal", "xActive", "xCancelRequested", "xCanceling")
    before = caller.get(*pins)
    pairs = [("xAccept", "xReject"), ("xAcceptCancel", "xRejectCancel"), ("xSucceed", "xAbort")]
    for steps in [*((step,) for step in STEPS if step not in LEGAL[state]), *pairs]:
        caller.set(**dict.fromkeys(steps, True))
        cell.scan(2)
        assert caller.get("udiError", "eError") == (ErrorNumber.ILLEGAL_STEP,) * 2, steps
        assert caller.get(*pins) == before, steps
        caller.set(**dict.fromkeys(steps, False))
        cell.scan()
        assert caller.get("udiError") == 0
    assert caller.answer() is None
    for step in LEGAL[state][:1]:
        end(cell, caller, step)
        assert caller.get(*pins) != before


@pytest.mark.parametrize("accepted", [False, True])
def test_stop_and_run_forgets_the_goal(cell: CallCell, accepted: bool) -> None:
    """Neither an offered nor a running goal survives STOP → RUN; later messages of it begin nothing."""
    caller, _ = offered(cell, accepted=accepted)
    cell.machine.stop()
    cell.machine.start()
    for _ in range(60):
        cell.scan()
        assert caller.get("xGoal", "xActive") == (False, False)
    caller.ask(CALL + CANCEL)
    cell.scan(10)
    assert caller.get("xGoal", "xActive") == (False, False)
    answer = caller.answer()
    assert answer is None or answer[0] == spec.ANSWER_FATE_UNKNOWN
    caller.call(12)
    cell.until(lambda: caller.get("xGoal"))
    assert caller.get("goal.data") == 12


def test_a_program_is_told_that_its_objects_were_retired(cell: CallCell) -> None:
    """As of an action that has left the configuration: its client was told that the goal is aborted."""
    caller, _ = offered(cell)
    caller.ask(CALL + CANCEL)
    caller.retire()
    cell.until(lambda: caller.get("xCallerGone"), 100)
    assert caller.get("xActive")
    caller.set(xAbort=True)
    cell.until(lambda: not caller.get("xActive"))
    assert not caller.get("xCallerGone")


@pytest.mark.parametrize("accepted", [False, True])
def test_replaced_objects_orphan_the_goal(cell: CallCell, accepted: bool) -> None:
    """An accepted goal is still the program's to end; one that was only shown is taken back."""
    caller, _ = offered(cell, accepted=accepted)
    caller.retire()
    again = ActionCaller(cell)
    cell.until(lambda: again.get("xGoal", "xActive", "xCallerGone") == (False, accepted, accepted))
    cell.until(lambda: again.get("xAttached"))
    again.call(12)
    if accepted:
        cell.scan(10)
        assert again.get("goal.data") == 11
        again.set(xAbort=True)
    cell.until(lambda: again.get("xGoal"))
    assert again.get("goal.data", "xCallerGone") == (12, False)
    assert again.answer() is None


def test_online_change_of_a_server(plc: CallCell) -> None:
    """A running goal outlives an online change."""
    caller, number = offered(plc)
    plc.machine.online_change()
    plc.scan(3)
    assert end(plc, caller, "xSucceed", 3) == (spec.ANSWER_SUCCEEDED, number, 3, 0)


def test_a_new_bridge(cell: CallCell) -> None:
    """A running goal outlives the bridge; the result finds the next one."""
    caller, number = offered(cell)
    caller.close()
    cell.scan(300, beats=False)
    assert caller.get("xActive", "xPeerAlive") == (True, False)
    again = ActionCaller(cell)
    assert end(cell, again, "xSucceed", 3) == (spec.ANSWER_SUCCEEDED, number, 3, 0)
