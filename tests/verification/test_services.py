"""The blocks of services, executed: every line of the tables in docs/reference/blocks."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest

from rosplc.reasons import Reason
from rosplc.shm import constants as spec
from rosplc.shm.constants import ErrorNumber
from tests.verification.call_cell import CallCell, Caller, Server, VirtualMachine, made_cell
from tests.verification.plc_cell import needs_armhf

pytestmark = pytest.mark.verifies("call-blocks", own="translated Structured Text, 64 and 32 bits; SIGKILL")

DELAYED = pytest.param("delayed", marks=pytest.mark.foreign)
ENDS = ("xDone", "xBusy", "xError", "xAborted")
DONE, BUSY, ERROR, ABORTED, IDLE = (
    tuple(name == one for name in ENDS) for one in ("xDone", "xBusy", "xError", "xAborted", "")
)
CALL, WITHDRAWN = spec.ASK_CALL, spec.ASK_CALL + spec.ASK_WITHDRAWN


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


def connected(cell: CallCell, use: str = "close") -> Server:
    """Return a server that the PLC can call."""
    server = Server(cell, use)
    cell.until(lambda: server.get("xServer", "xAttached") == (True, True))
    return server


def serving(cell: CallCell) -> Caller:
    """Return a caller whose PLC is ready."""
    caller = Caller(cell)
    cell.until(lambda: caller.get("xAttached", "xPeerAlive") == (True, True))
    return caller


def why(server: Server) -> tuple[int, int, int]:
    return server.get("udiError", "eError", "eReason")


# ---- the PLC calls


def test_a_call(cell: CallCell) -> None:
    """A rising edge sends request once; xDone comes with response, and stands until xExecute falls."""
    server = connected(cell)
    assert server.get(*ENDS) == IDLE
    server.set(**{"request.data": 41, "xExecute": True})
    cell.scan()
    assert server.get(*ENDS) == BUSY
    server.set(**{"request.data": 99})  # taken over at the edge
    asked = cell.until(server.take)
    assert (asked[0], asked[2]) == (CALL, 41)
    cell.scan(5)
    assert server.take() is None
    server.answer(asked[1], value=42)
    cell.until(lambda: server.get(*ENDS) == DONE)
    cell.scan(20)
    assert server.get(*ENDS) == DONE
    assert server.get("response.data", "udiError", "udiCalls", "udiLate") == (42, 0, 1, 0)
    assert server.take() is None
    server.set(xExecute=False)
    cell.scan()
    assert server.get(*ENDS) == IDLE


def test_execute_falls_early_and_rises_while_busy(cell: CallCell) -> None:
    """A falling edge ends nothing; a rising one while busy is ignored; the end then stands for one cycle."""
    server = connected(cell)
    server.set(xExecute=True)
    cell.scan()
    server.set(xExecute=False)
    cell.scan()
    assert server.get(*ENDS) == BUSY
    server.set(xExecute=True)
    cell.scan(2)
    server.set(xExecute=False)
    asked = cell.until(server.take)
    server.answer(asked[1], value=7)
    for _ in range(10):
        cell.scan()
        if server.get(*ENDS) != BUSY:
            break
    assert server.get(*ENDS) == DONE
    cell.scan()
    assert server.get(*ENDS) == IDLE
    cell.scan(10)
    assert server.take() is None
    assert server.get("udiCalls") == 1


def test_a_new_edge_right_after_the_end_calls_again(cell: CallCell) -> None:
    """The cycle after the end may begin the next call; its number is another."""
    server = connected(cell)
    numbers = []
    for value in range(3):
        server.set(**{"request.data": value, "xExecute": True})
        cell.scan()
        server.set(xExecute=False)
        asked = cell.until(server.take)
        numbers.append(asked[1])
        server.answer(asked[1], value=value)
        cell.until(lambda: server.get("xDone"))
        assert server.get("response.data") == value
    assert [number & 0xFFFFFFFF for number in numbers] == [1, 2, 3]
    assert len({number >> 32 for number in numbers}) == 1


@pytest.mark.parametrize("there", ["nothing", "bridge"])
def test_without_bridge_or_server(cell: CallCell, there: str) -> None:
    """The call waits, unsent, until tTimeout: not executed. With T#0s it waits for ever, and is then sent."""
    probe = Server(cell, "close", servers=0)
    if there == "nothing":
        probe.close()
        for path in Path(cell.namespace.directory).iterdir():
            path.unlink()
    probe.set(xExecute=True, tTimeout=300)
    cell.scan(30)
    assert probe.get(*ENDS) == BUSY
    assert not probe.get("xServer")
    cell.scan(2)
    assert probe.get(*ENDS) == ERROR
    assert why(probe) == (ErrorNumber.NOT_EXECUTED, ErrorNumber.NOT_EXECUTED, Reason.TIME_OUT)
    probe.set(xExecute=False)
    cell.scan()
    probe.set(xExecute=True, tTimeout=0)
    cell.scan(500)
    assert probe.get(*ENDS) == BUSY
    if there == "nothing":
        assert probe.get("udiError") == ErrorNumber.NO_OBJECT
        server = Server(cell)
    else:
        server = probe
        assert server.take() is None
        server.requests.set_sinks(1)
    asked = cell.until(server.take)
    server.answer(asked[1])
    cell.until(lambda: server.get(*ENDS) == DONE)


def test_time_out_of_a_call_that_had_not_begun(cell: CallCell) -> None:
    """A call that nobody took is withdrawn: not executed, and safe to repeat."""
    server = connected(cell)
    server.set(xExecute=True, tTimeout=100)
    cell.until(lambda: server.get(*ENDS) == ERROR)
    assert why(server) == (ErrorNumber.NOT_EXECUTED, ErrorNumber.NOT_EXECUTED, Reason.TIME_OUT)
    asked = server.take()
    assert asked is not None and asked[0] == WITHDRAWN


def test_time_out_of_a_call_that_had_begun(cell: CallCell) -> None:
    """A call that was taken and not answered in time: fate unknown; its answer is late, and counted."""
    server = connected(cell)
    server.set(xExecute=True, tTimeout=100)
    asked = cell.until(server.take)
    assert server.requests.begin()
    cell.until(lambda: server.get(*ENDS) == ERROR)
    assert why(server) == (ErrorNumber.FATE_UNKNOWN, ErrorNumber.FATE_UNKNOWN, Reason.TIME_OUT)
    withdrawn = server.take()
    assert withdrawn is not None and withdrawn[:2] == (WITHDRAWN, asked[1])
    server.answer(asked[1], value=3)
    cell.scan(10)
    assert server.get(*ENDS) == ERROR
    assert server.get("udiLate", "response.data") == (1, 0)
    server.set(xExecute=False)
    cell.scan()
    server.set(xExecute=True)
    again = cell.until(server.take)
    assert again[1] == asked[1] + 1
    server.answer(asked[1], value=3)  # of the call before: never completes this one
    cell.scan(5)
    assert server.get(*ENDS) == BUSY
    server.answer(again[1], value=4)
    cell.until(lambda: server.get(*ENDS) == DONE)
    assert server.get("response.data") == 4


@pytest.mark.parametrize("begun", [False, True])
def test_abort(cell: CallCell, begun: bool) -> None:
    """To abort a call in hand withdraws it: xAborted, and eError tells whether it may have begun."""
    server = connected(cell)
    server.set(xExecute=True)
    cell.until(lambda: server.get("udiCalls") == 1)
    cell.scan(2)
    if begun:
        assert server.take()
    server.set(xAbort=True)
    cell.until(lambda: server.get(*ENDS) == ABORTED, 5)
    number = ErrorNumber.FATE_UNKNOWN if begun else ErrorNumber.NOT_EXECUTED
    assert why(server) == (number, number, 0)
    cell.scan(3)
    assert server.get(*ENDS) == ABORTED
    withdrawn = server.take()
    assert withdrawn is not None and withdrawn[0] == WITHDRAWN
    server.set(xExecute=False, xAbort=False)
    cell.scan()
    assert server.get(*ENDS) == IDLE


def test_abort_with_execute_sends_nothing(cell: CallCell) -> None:
    """To abort at the rising edge gives xAborted at once; without a call it does nothing."""
    server = connected(cell)
    server.set(xAbort=True)
    cell.scan(3)
    assert server.get(*ENDS) == IDLE
    server.set(xExecute=True)
    cell.scan()
    assert server.get(*ENDS) == ABORTED
    server.set(xAbort=False)
    cell.scan(10)
    assert server.get(*ENDS) == ABORTED
    assert server.take() is None


@pytest.mark.parametrize(
    ("status", "reason", "number"),
    [
        (spec.ANSWER_NOT_EXECUTED, Reason.NO_SERVER, ErrorNumber.NOT_EXECUTED),
        (spec.ANSWER_FATE_UNKNOWN, Reason.BRIDGE_RESTARTED, ErrorNumber.FATE_UNKNOWN),
        (spec.ANSWER_UNREADABLE, Reason.TOO_LARGE, ErrorNumber.UNREADABLE),
        (spec.ANSWER_SUCCEEDED, 0, ErrorNumber.FATE_UNKNOWN),  # of an action: the call has ended all the same
    ],
)
def test_the_ways_to_fail(cell: CallCell, status: int, reason: int, number: int) -> None:
    """What the answer says is what the block says."""
    server = connected(cell)
    server.set(xExecute=True)
    asked = cell.until(server.take)
    server.answer(asked[1], status, 5, reason)
    cell.until(lambda: server.get(*ENDS) == ERROR)
    assert why(server) == (number, number, reason)
    assert server.get("response.data") == 0
    assert str(int(number)) in server.get("sState")


def test_silent_bridge(cell: CallCell) -> None:
    """While the bridge is silent the call stays open; the bridge that comes back answers it."""
    server = connected(cell)
    server.set(xExecute=True)
    asked = cell.until(server.take)
    server.close()
    cell.scan(400, beats=False)
    assert server.get(*ENDS) == BUSY
    assert server.get("xPeerAlive", "xServer", "udiError") == (False, False, ErrorNumber.PEER_SILENT)
    again = Server(cell)
    cell.until(lambda: again.get("xPeerAlive"))
    again.answer(asked[1], value=9)
    cell.until(lambda: again.get(*ENDS) == DONE)
    assert again.get("response.data") == 9


@pytest.mark.parametrize("limit", [{"tTimeout": 3000}, {"tBridgeGrace": 300}], ids=str)
def test_time_out_while_the_bridge_is_silent(cell: CallCell, limit: dict[str, int]) -> None:
    """The fate of a call is unknown then; it is withdrawn before the next one is sent."""
    server = connected(cell)
    server.set(xExecute=True, **limit)
    asked = cell.until(server.take)
    server.close()
    cell.until(lambda: server.get(*ENDS) == ERROR, beats=False)
    assert why(server)[1:] == (ErrorNumber.FATE_UNKNOWN, Reason.TIME_OUT)
    again = Server(cell)
    withdrawn = cell.until(again.take)
    assert withdrawn[:2] == (WITHDRAWN, asked[1])
    again.set(xExecute=False)
    cell.scan()
    again.set(xExecute=True, **dict.fromkeys(limit, 0))
    asked = cell.until(again.take)
    assert asked[0] == CALL
    again.answer(asked[1])
    cell.until(lambda: again.get(*ENDS) == DONE)


def test_only_silence_counts_as_such(cell: CallCell) -> None:
    """A call may take longer than the bridge may be silent, and each silence counts by itself."""
    server = connected(cell)
    server.set(xExecute=True, tBridgeGrace=1000)
    asked = cell.until(server.take)
    cell.scan(200)
    for _ in range(3):
        cell.until(lambda: not server.get("xPeerAlive"), beats=False)
        cell.scan(60, beats=False)
        cell.until(lambda: server.get("xPeerAlive"))
    assert server.get(*ENDS) == BUSY
    server.answer(asked[1])
    cell.until(lambda: server.get(*ENDS) == DONE)


@pytest.mark.parametrize("begun", [False, True])
def test_replaced_objects_end_the_call(cell: CallCell, begun: bool) -> None:
    """Objects that are retired answer no more: fate unknown if the call was taken, else not executed."""
    server = connected(cell)
    server.set(xExecute=True)
    cell.until(lambda: server.get("udiCalls") == 1)
    cell.scan(2)
    if begun:
        assert server.take()
    server.retire()
    again = Server(cell)
    cell.until(lambda: again.get(*ENDS) == ERROR)
    number = ErrorNumber.FATE_UNKNOWN if begun else ErrorNumber.NOT_EXECUTED
    assert why(again)[1:] == (number, Reason.BRIDGE_RESTARTED)
    again.set(xExecute=False)
    cell.until(lambda: again.get("xServer"))
    assert again.take() is None
    again.set(xExecute=True)
    asked = cell.until(again.take)
    again.answer(asked[1])
    cell.until(lambda: again.get(*ENDS) == DONE)


def test_removed_objects_leave_the_fate_unknown(cell: CallCell) -> None:
    """The bridge that holds them may be stopped for a while only, and take the call then."""
    server = connected(cell)
    server.set(xExecute=True)
    cell.until(lambda: server.get("udiCalls") == 1)
    cell.scan(2)
    cell.uses.remove(server)
    for path in Path(cell.namespace.directory).iterdir():
        path.unlink()
    again = Server(cell)
    cell.until(lambda: again.get(*ENDS) == ERROR)
    assert why(again)[1:] == (ErrorNumber.FATE_UNKNOWN, Reason.BRIDGE_RESTARTED)
    assert server.take()
    cell.uses.append(server)


def test_an_answer_for_an_earlier_life_completes_nothing(cell: CallCell) -> None:
    """A PLC that starts again counts from 1 again: only the claim in the number tells its calls apart."""
    server = connected(cell)
    server.set(xExecute=True)
    old = cell.until(server.take)
    cell.machine.stop()
    cell.machine.start()
    cell.until(lambda: server.get("xServer"))
    assert server.take() is None
    server.set(xExecute=True)
    new = cell.until(server.take)
    assert new[1] & 0xFFFFFFFF == old[1] & 0xFFFFFFFF
    server.answer(old[1], value=66)
    cell.scan(10)
    assert server.get(*ENDS) == BUSY
    assert server.get("udiLate") == 1
    server.answer(new[1], value=5)
    cell.until(lambda: server.get(*ENDS) == DONE)
    assert server.get("response.data") == 5


def test_online_change_keeps_the_call(plc: CallCell) -> None:
    """An online change moves the instances; the call in hand goes on, and nothing is sent again."""
    server, other = connected(plc), connected(plc, "close_left")
    server.set(xExecute=True)
    other.set(**{"xExecute": True, "request.data": 5})
    asked = plc.until(server.take)
    plc.until(other.take)
    for _ in range(3):
        plc.machine.online_change()
        plc.scan(3)
    assert server.take() is None
    assert other.take() is None
    server.answer(asked[1], value=1)
    plc.until(lambda: server.get(*ENDS) == DONE)
    assert other.get(*ENDS) == BUSY


def test_instances_have_objects_of_their_own(cell: CallCell) -> None:
    """Calls of several instances in two tasks do not meet; long names are shortened as by the bridge."""
    servers = [connected(cell, use) for use in ("close", "close_left", "long")]
    for value, server in enumerate(servers):
        server.set(**{"request.data": value, "xExecute": True})
    asked = [cell.until(server.take) for server in servers]
    assert [item[2] for item in asked] == [0, 1, 2]
    for server, item in reversed([*zip(servers, asked, strict=True)]):
        server.answer(item[1], value=10 + item[2])
    cell.scan(5)
    assert [server.get("response.data", "xDone") for server in servers] == [(10 + i, True) for i in range(3)]


def test_a_second_program_is_refused(cell: CallCell) -> None:
    """Two PLCs with one use of a service: the second waits for the claim and says so (114)."""
    server = connected(cell)
    second = CallCell(Path(cell.namespace.directory), cell.make)
    for _ in range(50):
        cell.scan()
        second.scan()
    path = server.path
    second.machine.set(f"{path}.xExecute", True)
    for _ in range(20):
        cell.scan()
        second.scan()
    assert second.machine.get(f"{path}.udiError") == ErrorNumber.CLAIMED
    assert second.machine.get(f"{path}.xBusy")
    assert [bool(line.claim) for line in server.channels[1].snapshot().readers] == [True, False, False, False]
    second.close()
    assert server.take() is None


# ---- the PLC is the server


def test_a_request(cell: CallCell) -> None:
    """A request is shown until xReply rises; the answer repeats number and client."""
    caller = serving(cell)
    number = caller.call(41)
    cell.until(lambda: caller.get("xRequest"))
    assert caller.get("request.data", "udiCalls", "xCallerGone") == (41, 1, False)
    cell.scan(20)
    assert caller.get("xRequest")
    assert caller.get("tAge") >= 200
    assert caller.answer() is None
    caller.set(**{"response.data": 42, "xReply": True})
    cell.scan()
    assert not caller.get("xRequest")
    assert cell.until(caller.answer) == (spec.ANSWER_DONE, number, 42, 0)
    cell.scan(20)
    assert caller.answer() is None
    assert caller.get("udiError") == 0


def test_a_reply_that_stays_true_answers_one_call(cell: CallCell) -> None:
    """Only a rising edge answers: the next request stands until the program has an answer for it."""
    caller = serving(cell)
    caller.call(1)
    cell.until(lambda: caller.get("xRequest"))
    caller.set(xReply=True)
    cell.until(caller.answer)
    caller.call(2)
    cell.until(lambda: caller.get("xRequest"))
    cell.scan(10)
    assert caller.get("xRequest", "request.data") == (True, 2)
    assert caller.answer() is None
    caller.set(xReply=False)
    cell.scan()
    caller.set(xReply=True)
    assert cell.until(caller.answer)[1] == caller.correlation


def test_reject(cell: CallCell) -> None:
    """A rejected call ends as not executed."""
    caller = serving(cell)
    number = caller.call(1)
    cell.until(lambda: caller.get("xRequest"))
    caller.set(xReject=True)
    cell.scan()
    assert not caller.get("xRequest")
    assert cell.until(caller.answer) == (spec.ANSWER_NOT_EXECUTED, number, 0, Reason.REJECTED)


def test_illegal_steps(cell: CallCell) -> None:
    """An answer without a request, and two answers at once, are refused with 145 and change nothing."""
    caller = serving(cell)
    caller.set(xReply=True)
    cell.scan()
    assert caller.get("udiError", "eError") == (ErrorNumber.ILLEGAL_STEP, ErrorNumber.ILLEGAL_STEP)
    caller.set(xReply=False)
    cell.scan()
    assert caller.get("udiError") == 0
    caller.call(1)
    cell.until(lambda: caller.get("xRequest"))
    caller.set(xReply=True, xReject=True)
    cell.scan(3)
    assert caller.get("xRequest", "udiError") == (True, ErrorNumber.ILLEGAL_STEP)
    assert caller.answer() is None
    caller.set(xReply=False, xReject=False)
    cell.scan()
    caller.set(xReply=True)
    assert cell.until(caller.answer)[0] == spec.ANSWER_DONE


def test_what_waited_is_not_executed(cell: CallCell) -> None:
    """A call published while no PLC held the line is not shown to the one that comes (M27)."""
    caller = Caller(cell)
    caller.call(1)
    cell.until(lambda: caller.get("xAttached", "xPeerAlive") == (True, True))
    cell.scan(20)
    assert not caller.get("xRequest")
    assert not caller.withdraw()
    cell.scan(10)
    caller.call(2)
    cell.until(lambda: caller.get("xRequest"))
    assert caller.get("request.data") == 2


@pytest.mark.parametrize("shown", [False, True])
def test_stop_and_run_executes_nothing(cell: CallCell, shown: bool) -> None:
    """STOP → RUN: neither the call in hand nor one published meanwhile is shown; taken stays as it was."""
    caller = serving(cell)
    caller.call(1)
    if shown:
        cell.until(lambda: caller.get("xRequest"))
    cell.machine.stop()
    if not shown:
        caller.call(2)
    cell.machine.start()
    for _ in range(100):
        cell.scan()
        assert not caller.get("xRequest")
    assert caller.get("xAttached", "xPeerAlive") == (True, True)
    assert caller.withdraw() is shown
    cell.scan(10)
    answer = caller.answer()  # who is there now cannot know
    assert answer is None or answer[0] == spec.ANSWER_FATE_UNKNOWN or not shown
    caller.call(3)
    cell.until(lambda: caller.get("xRequest"))
    assert caller.get("request.data") == 3


def test_a_call_withdrawn_before_it_began(cell: CallCell) -> None:
    """It is not shown; the caller knows at once, and gets the one answer that ends it (M29)."""
    caller = serving(cell)
    number = caller.call(1)
    assert caller.withdraw() is False
    cell.until(lambda: caller.get("udiRefused") == 1)
    assert caller.get("udiCalls", "xRequest") == (0, False)
    status, correlation, _, _ = cell.until(caller.answer)
    assert correlation == number
    assert status in (spec.ANSWER_NOT_EXECUTED, spec.ANSWER_FATE_UNKNOWN)  # the first message after a start
    number = caller.call(2)
    cell.until(lambda: caller.get("xRequest"))
    caller.set(xReply=True)
    cell.until(caller.answer)
    number = caller.call(3)
    assert caller.withdraw() is False
    assert cell.until(caller.answer) == (spec.ANSWER_NOT_EXECUTED, number, 0, Reason.CALLER_GONE)


def test_the_caller_goes_while_the_call_is_in_hand(cell: CallCell) -> None:
    """The block shows it; the request stays until the program ends it; the next call waits."""
    caller = serving(cell)
    first = caller.call(1)
    cell.until(lambda: caller.get("xRequest"))
    assert caller.withdraw() is True
    cell.until(lambda: caller.get("xCallerGone"))
    second = caller.call(2)
    cell.scan(20)
    assert caller.get("xRequest", "request.data") == (True, 1)
    caller.set(xReply=True)
    assert cell.until(caller.answer)[1] == first
    cell.until(lambda: caller.get("request.data") == 2 and caller.get("xRequest"))
    assert not caller.get("xCallerGone")
    caller.set(xReply=False)
    cell.scan()
    caller.set(xReply=True)
    assert cell.until(caller.answer)[1] == second


def test_a_call_that_overtakes_a_withdrawn_one(cell: CallCell) -> None:
    """A withdrawal that the PLC never reads: another call that comes says as much."""
    caller = serving(cell)
    caller.call(1)
    cell.until(lambda: caller.get("xRequest"))
    caller.withdraw()
    caller.call(2)
    cell.until(lambda: caller.get("xCallerGone"))
    assert caller.get("request.data") == 1
    if caller.withdraw():  # it waits in the PLC, which has read it, but not begun
        assert isinstance(cell.machine, VirtualMachine), "another tells what it takes when it begins"
        assert cell.until(caller.answer)[0] == spec.ANSWER_NOT_EXECUTED
    cell.scan(10)
    caller.set(xReply=True)
    cell.scan(20)
    assert caller.get("xRequest", "udiCalls") == (False, 1)


def test_a_silent_bridge_and_one_that_adopts(cell: CallCell) -> None:
    """A call in hand outlives a bridge; the next one gets its answer."""
    caller = serving(cell)
    number = caller.call(1)
    cell.until(lambda: caller.get("xRequest"))
    caller.close()
    cell.scan(400, beats=False)
    assert caller.get("xRequest", "xPeerAlive", "udiError") == (True, False, ErrorNumber.PEER_SILENT)
    caller.set(**{"response.data": 8, "xReply": True})
    cell.scan(20, beats=False)
    again = Caller(cell)
    assert cell.until(again.answer) == (spec.ANSWER_DONE, number, 8, 0)


def test_replaced_objects_orphan_the_call(cell: CallCell) -> None:
    """The caller that waited has been told; the program still ends its call, and the answer goes nowhere."""
    caller = serving(cell)
    caller.call(1)
    cell.until(lambda: caller.get("xRequest"))
    caller.retire()
    again = Caller(cell)
    cell.until(lambda: again.get("xCallerGone"))
    cell.until(lambda: again.get("xAttached"))  # to the next object: what waits there before is not shown
    assert again.get("xRequest")
    again.call(2)
    cell.scan(20)
    assert again.get("request.data") == 1
    again.set(xReply=True)
    cell.until(lambda: again.get("request.data") == 2 and again.get("xRequest"))
    assert again.answer() is None
    again.set(xReply=False)
    cell.scan()
    again.set(xReply=True)
    assert cell.until(again.answer)[1] == again.correlation


def test_online_change_of_a_server(plc: CallCell) -> None:
    """An online change keeps the call in hand, and shows none twice."""
    caller = serving(plc)
    number = caller.call(1)
    plc.until(lambda: caller.get("xRequest"))
    plc.machine.online_change()
    plc.scan(5)
    assert caller.get("xRequest", "udiCalls") == (True, 1)
    caller.set(xReply=True)
    plc.machine.online_change()
    assert plc.until(caller.answer)[:2] == (spec.ANSWER_DONE, number)
    plc.machine.online_change()
    plc.scan(20)
    assert caller.get("xRequest", "udiCalls") == (False, 1)


def test_retained_instances_forget_their_calls() -> None:
    """After a power cycle no call is in hand, and an xExecute or xReply that stayed TRUE is no edge."""

    def retain(texts: dict[str, str]) -> dict[str, str]:
        return {**texts, "ROS_Services": texts["ROS_Services"].replace("VAR_GLOBAL\n", "VAR_GLOBAL RETAIN\n")}

    with made_cell("fences", retain) as cell:
        _retained(cell)


def _retained(cell: CallCell) -> None:
    server, caller = connected(cell), serving(cell)
    server.set(**{"xExecute": True, "request.data": 1})
    old = cell.until(server.take)
    caller.call(2)
    cell.until(lambda: caller.get("xRequest"))
    caller.set(xReply=True)
    cell.machine.power_cycle()
    assert server.get("xExecute", "request.data") == (True, 1)  # what is retained
    assert server.get(*ENDS) == IDLE
    for _ in range(120):
        cell.scan()
        assert server.get(*ENDS) == IDLE
        assert not caller.get("xRequest")
    assert server.get("xServer", "udiError") == (True, 0)
    assert caller.get("xAttached", "udiError") == (True, 0)
    assert server.take() is None
    assert caller.answer() is None
    server.answer(old[1], value=9)
    cell.scan(3)
    assert server.get(*ENDS) == IDLE
    server.set(xExecute=False)
    caller.set(xReply=False)
    cell.scan()
    server.set(xExecute=True)
    asked = cell.until(server.take)
    assert asked[1] >> 32 != old[1] >> 32
    server.answer(asked[1], value=4)
    cell.until(lambda: server.get(*ENDS) == DONE)
    number = caller.call(3)
    cell.until(lambda: caller.get("xRequest"))
    assert caller.get("request.data") == 3
    caller.set(xReply=True)
    assert cell.until(caller.answer)[1] == number
