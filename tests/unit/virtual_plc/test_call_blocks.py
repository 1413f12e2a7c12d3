"""The Server and Client blocks at every edge, with a bridge's side that the test steps."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from functools import partial
from typing import Any

import pytest

from rosplc.config import parse_config, resolve
from rosplc.config.resolve import describe_call
from rosplc.errors import LayoutError
from rosplc.reasons import Reason
from rosplc.shm import SERVICE, Answerer, Caller, Namespace, OwnedChannel, Part, SlotInfo
from rosplc.shm.constants import (
    ANSWER_DONE,
    ANSWER_FATE_UNKNOWN,
    ANSWER_NOT_EXECUTED,
    ANSWER_SUCCEEDED,
    ANSWER_UNREADABLE,
    ErrorNumber,
)
from rosplc.shm.owned import retire_file
from rosplc.virtual_plc import ServiceClient, ServiceServer
from rosplc.virtual_plc.task import Scan, enter_scan

TYPE = "std_srvs/srv/SetBool"
A = bytes(range(16))


class Side:
    """The bridge's side of /s, and scans of a PLC whose clock the test steps."""

    def __init__(self, namespace: Namespace, server: str) -> None:
        (self.plan,) = resolve(parse_config(f"services: {{/s: {{type: {TYPE}, server: {server}}}}}")).services
        self.namespace, self.server, self.now_ns = namespace, server, 10**12
        self.layouts = dict(zip(SERVICE, self.plan.layouts, strict=True))
        self.open()

    def open(self) -> None:
        parts = [
            (describe_call(self.plan, part, "jazzy", "b"), each.size) for part, each in self.layouts.items()
        ]
        request, response = self.channels = OwnedChannel.open_together(self.namespace, parts)
        mine, theirs = (request, response) if self.server == "plc" else (response, request)
        self.writer, self.reader = mine.writer(100), theirs.reader(100)
        self.sent, self.taken = (
            (Part.REQUEST, Part.RESPONSE) if self.server == "plc" else (Part.RESPONSE, Part.REQUEST)
        )
        if self.server == "plc":
            self.caller = Caller(request, self.writer, follows_claim=True)
        else:
            self.answerer = Answerer(request, self.reader, response)
            self.known(1)

    def known(self, servers: int) -> None:
        self.writer.set_sources(servers)
        self.reader.set_sinks(servers)

    def send(self, fields: dict[str, Any], **words: Any) -> None:
        self.writer.publish(self.layouts[self.sent].pack(fields), **words)

    def call(self, data: bool = True) -> int:
        return self.caller.call(partial(self.send, {"data": data}), client=A)

    def withdraw(self) -> bool:
        return self.caller.withdraw(partial(self.send, {}))

    def answer(self, info: SlotInfo, status: int, reason: int = 0, **fields: Any) -> None:
        self.send(fields, correlation=info.correlation, status=status, reason=reason)
        self.answerer.answered(info.correlation)

    def take(self) -> tuple[SlotInfo, dict[str, Any]] | None:
        record = bytearray(self.layouts[self.taken].size)
        info = self.reader.latest(record)
        return None if info is None else (info, self.layouts[self.taken].to_dict(record))

    def took(self) -> SlotInfo:
        found = self.take()
        assert found is not None
        if self.server == "ros":
            assert self.answerer.take(found[0])
        return found[0]

    def scan(self, block: Callable[[], Any], times: int = 1, seconds: float = 0.01) -> None:
        for _ in range(times):
            self.writer.beat()
            self.reader.beat()
            self.now_ns += round(seconds * 1e9)
            for _ in range(2):  # each object takes an attempt to open of its own
                enter_scan(Scan("Task", 1, self.now_ns))
                block()
            enter_scan(None)

    def close(self) -> None:
        for channel in self.channels:
            channel.close()


@pytest.fixture
def sides(shm_namespace: Namespace) -> Iterator[Callable[[str], tuple[Side, Any]]]:
    opened: list[Any] = []

    def make(server: str) -> tuple[Side, Any]:
        side = Side(shm_namespace, server)
        kind = ServiceServer if server == "plc" else ServiceClient
        block = kind("/s", prefix=shm_namespace.prefix, beat_ms=100)
        opened.extend((block, side))
        side.scan(block, 3)
        assert (block.xAttached, block.xPeerAlive, block.xError) == (True, True, False), block.reason
        return side, block

    yield make
    for one in opened:
        one.close()


Sides = Callable[[str], tuple[Side, Any]]


def test_a_request_stands_until_the_answer(sides: Sides) -> None:
    side, block = sides("plc")
    number = side.call()
    side.scan(block, 3, 0.1)
    assert (block.xRequest, block.request.data, block.udiCalls, block.xCallerGone) == (True, True, 1, False)
    assert block.age == pytest.approx(0.2)
    assert side.caller.begun()
    block.response.message = "ok"
    block.xReply = True
    side.scan(block)
    info, answer = side.take() or pytest.fail("no answer")
    assert (info.correlation, info.status, info.client) == (number, ANSWER_DONE, A)
    assert (answer["message"], block.xRequest) == ("ok", False)
    side.caller.answer(info)
    side.call(False)
    side.scan(block, 2)
    assert block.xRequest  # xReply is TRUE still, and no edge
    assert side.take() is None


def test_a_program_that_refuses(sides: Sides) -> None:
    side, block = sides("plc")
    side.call()
    side.scan(block)
    block.xReject = True
    side.scan(block)
    info = side.took()
    assert (info.status, info.reason) == (ANSWER_NOT_EXECUTED, Reason.REJECTED)


def test_an_answer_without_a_call(sides: Sides) -> None:
    side, block = sides("plc")
    block.xReply = True
    enter_scan(Scan("Task", 1, side.now_ns))
    block()
    enter_scan(None)
    assert block.eError is ErrorNumber.ILLEGAL_STEP
    assert side.take() is None


def test_a_response_that_does_not_fit(sides: Sides) -> None:
    side, block = sides("plc")
    side.call()
    side.scan(block)
    block.response.message = "x" * 81
    block.xReply = True
    with pytest.raises(LayoutError):
        side.scan(block)
    block.xReply = False
    block.response.message = "fits"
    side.scan(block)
    block.xReply = True
    side.scan(block)
    assert side.took().status == ANSWER_DONE


@pytest.mark.parametrize("begun", [True, False])
def test_a_caller_that_waits_no_longer(sides: Sides, begun: bool) -> None:
    side, block = sides("plc")
    side.call()
    side.scan(block)
    block.xReject = True
    side.scan(block)
    side.caller.answer(side.took())
    block.xReject = False
    side.call()
    if begun:
        side.scan(block)
    assert side.withdraw() is begun
    side.scan(block)
    assert (block.xRequest, block.xCallerGone) == (begun, begun)
    if begun:
        block.xReply = True
        side.scan(block)
    info = side.took()
    assert (info.status, info.reason) == (
        (ANSWER_DONE, 0) if begun else (ANSWER_NOT_EXECUTED, Reason.CALLER_GONE)
    )
    assert not block.xCallerGone


def test_nothing_that_waited_is_executed(sides: Sides, shm_namespace: Namespace) -> None:
    """A call from before the block's claim is not shown; withdrawn later, its fate is not known here."""
    side, block = sides("plc")
    block.close()
    side.call()
    again = ServiceServer("/s", prefix=shm_namespace.prefix, beat_ms=100)
    side.scan(again, 3)
    assert again.xAttached
    assert not again.xRequest
    side.withdraw()
    side.scan(again, 2)
    assert side.took().status == ANSWER_FATE_UNKNOWN
    side.call()
    side.scan(again)
    assert again.xRequest
    again.close()


def test_the_objects_of_a_call_are_replaced(sides: Sides) -> None:
    """The bridge has ended it: it is shown as such until the program is done, and not answered."""
    side, block = sides("plc")
    side.call()
    side.scan(block)
    for channel in side.channels:
        channel.retire()
    side.open()
    side.scan(block, 30)
    assert (block.xRequest, block.xCallerGone, block.xAttached) == (True, True, True)
    block.xReply = True
    side.scan(block, 2)
    assert not block.xRequest
    assert side.take() is None
    side.call()
    block.xReply = False
    side.scan(block, 2)
    assert block.xRequest


def test_a_call_withdrawn_while_another_is_in_hand_is_never_shown(sides: Sides) -> None:
    """Its caller was told that it is safe to call again."""
    side, block = sides("plc")
    side.call()
    side.scan(block)
    for channel in side.channels:
        channel.retire()
    side.open()
    side.scan(block, 30)
    assert (block.xRequest, block.xAttached) == (True, True)  # the program is at the first one still
    side.call(False)
    side.scan(block, 2)
    side.withdraw()
    side.scan(block, 2)
    assert side.took().status == ANSWER_NOT_EXECUTED
    block.xReply = True
    side.scan(block, 4)
    assert (block.xRequest, block.udiCalls) == (False, 1)


def test_a_call_that_was_answered_and_is_then_withdrawn(sides: Sides) -> None:
    """There is no second answer: only the newest is read, and it would say that nothing was executed."""
    side, block = sides("plc")
    side.call()
    side.scan(block)
    block.xReply = True
    side.scan(block)
    side.withdraw()
    side.scan(block, 2)
    assert side.took().status == ANSWER_DONE
    assert not block.xRequest


def test_an_object_that_is_retired_while_a_call_is_begun(
    sides: Sides, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Nothing is raised about the other side."""
    side, block = sides("plc")
    side.call()
    take = block._in.take

    def retired_behind() -> SlotInfo | None:
        info: SlotInfo | None = take()
        if info is not None:
            for channel in side.channels:
                retire_file(os.open(channel.path, os.O_RDWR))
        return info

    monkeypatch.setattr(block._in, "take", retired_behind)
    side.scan(block, 2)
    assert not block.xRequest


def started(side: Side, block: ServiceClient, timeout: float = 0.0) -> SlotInfo:
    block.request.data = True
    block.xExecute, block.tTimeout = True, timeout
    side.scan(block, 2)
    assert (block.xBusy, block.xServer, block.udiCalls) == (True, True, 1)
    return side.took()


@pytest.mark.parametrize(
    ("status", "reason", "outcome"),
    [
        (ANSWER_DONE, 0, None),
        (ANSWER_NOT_EXECUTED, Reason.SERVER_FAILED, ErrorNumber.NOT_EXECUTED),
        (ANSWER_FATE_UNKNOWN, Reason.SERVER_GONE, ErrorNumber.FATE_UNKNOWN),
        (ANSWER_UNREADABLE, Reason.TOO_LARGE, ErrorNumber.UNREADABLE),
        (ANSWER_NOT_EXECUTED, 99, ErrorNumber.NOT_EXECUTED),
        (ANSWER_SUCCEEDED, 0, ErrorNumber.FATE_UNKNOWN),  # of an action: the call has ended all the same
    ],
)
def test_ends_of_a_call(sides: Sides, status: int, reason: int, outcome: ErrorNumber | None) -> None:
    side, block = sides("ros")
    info = started(side, block)
    side.answer(info, status, reason, message="hi")
    side.scan(block)
    assert (block.xBusy, block.xDone, block.xError, block.eError) == (
        False,
        not outcome,
        bool(outcome),
        outcome,
    )
    assert block.eReason == (reason if reason != 99 else 0)
    if not outcome:
        assert block.response.message == "hi"
    side.scan(block, 3)
    assert (block.xDone, block.xError) == (not outcome, bool(outcome))  # while xExecute is TRUE
    block.xExecute = False
    side.scan(block)
    assert (block.xDone, block.xError, block.eError) == (False, False, None)
    assert side.take() is None
    side.answer(info, status)
    side.scan(block)
    assert (block.udiLate, block.xDone) == (1, False)


def test_a_call_while_one_is_busy_is_ignored(sides: Sides) -> None:
    side, block = sides("ros")
    info = started(side, block)
    block.xExecute = False
    side.scan(block)
    block.xExecute = True
    side.scan(block)
    assert (block.xBusy, side.take()) == (True, None)
    block.xExecute = False
    side.scan(block)
    side.writer.beat()
    side.answer(info, ANSWER_DONE)
    enter_scan(Scan("Task", 1, side.now_ns))
    block()
    assert block.xDone  # for one scan
    block()
    enter_scan(None)
    assert not block.xDone


@pytest.mark.parametrize("taken", [True, False])
@pytest.mark.parametrize("abort", [True, False])
def test_giving_up(sides: Sides, taken: bool, abort: bool) -> None:
    side, block = sides("ros")
    block.xExecute, block.tTimeout = True, 0.0 if abort else 0.5
    side.scan(block)
    info = side.took() if taken else None
    block.xAbort = abort
    side.scan(block, 3, 0.3)
    outcome = ErrorNumber.FATE_UNKNOWN if taken else ErrorNumber.NOT_EXECUTED
    assert (block.xBusy, block.xAborted, block.xError, block.eError) == (False, abort, not abort, outcome)
    assert block.eReason is (Reason.NONE if abort else Reason.TIME_OUT)
    found = side.take()
    assert found is not None
    assert side.answerer.take(found[0]) == ("more" if info else "withdrawn")


def test_without_a_server_a_call_waits(sides: Sides) -> None:
    side, block = sides("ros")
    side.known(0)
    block.xExecute, block.tTimeout = True, 1.0
    side.scan(block, 5, 0.1)
    assert (block.xBusy, block.xServer, side.take()) == (True, False, None)
    side.scan(block, 8, 0.1)
    assert (block.eError, block.eReason) == (ErrorNumber.NOT_EXECUTED, Reason.TIME_OUT)
    block.xExecute = False
    side.scan(block)
    block.xExecute = True
    side.scan(block, 3)
    side.known(1)
    side.scan(block, 2)
    assert side.took().status == 1


def test_objects_that_are_replaced_end_a_call(sides: Sides) -> None:
    side, block = sides("ros")
    started(side, block)
    for channel in side.channels:
        channel.retire()
    side.open()
    side.scan(block, 30)
    assert (block.xBusy, block.eError) == (False, ErrorNumber.FATE_UNKNOWN)
    assert block.eReason is Reason.BRIDGE_RESTARTED


def test_without_a_bridge_a_call_ends_by_its_time(shm_namespace: Namespace) -> None:
    block = ServiceClient("/s", prefix=shm_namespace.prefix)
    now = 10**12
    block.xExecute, block.tTimeout = True, 0.5
    for _ in range(8):
        now += 100_000_000
        enter_scan(Scan("Task", 1, now))
        block()
    enter_scan(None)
    assert (block.xBusy, block.eError, block.xServer) == (False, ErrorNumber.NOT_EXECUTED, False)
    assert not block.xAttached
