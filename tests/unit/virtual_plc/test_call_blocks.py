"""What is special in the virtual PLC's blocks of calls; tests/verification runs them and the PLC's alike."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from functools import partial
from typing import Any

import pytest

from rosplc.config import parse_config, resolve
from rosplc.config.resolve import describe
from rosplc.errors import LayoutError
from rosplc.reasons import Reason
from rosplc.shm import SERVICE, Answerer, Caller, Namespace, OwnedChannel, Part, SlotInfo
from rosplc.shm.constants import (
    ANSWER_DONE,
    ANSWER_FATE_UNKNOWN,
    ANSWER_NOT_EXECUTED,
    ErrorNumber,
)
from rosplc.shm.owned import retire_file
from rosplc.virtual_plc import ActionClient, ServiceClient, ServiceServer
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
            (describe(self.plan, part, distro="jazzy", bridge="b"), each.size)
            for part, each in self.layouts.items()
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


def test_a_call_that_is_withdrawn_before_the_other_object_is_open(
    sides: Sides, shm_namespace: Namespace, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A new program without layouts refuses it, though it does not know yet what it answers with."""
    side, block = sides("plc")
    side.call()
    block.close()
    again = ServiceServer("/s", prefix=shm_namespace.prefix, beat_ms=100)
    look = again._in.look

    def withdrawn_behind(scan: Scan) -> None:
        look(scan)
        if side.caller.correlation and again._in.xReady:
            assert not again._out.xReady
            side.withdraw()
            side.caller.correlation = 0

    monkeypatch.setattr(again._in, "look", withdrawn_behind)
    side.scan(again, 3)
    assert side.took().status == ANSWER_FATE_UNKNOWN
    again.close()


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


def test_a_reason_that_is_none(sides: Sides) -> None:
    """A call that ends for a reason of a later format is ended anyway."""
    side, block = sides("ros")
    side.answer(started(side, block), ANSWER_NOT_EXECUTED, 99)
    side.scan(block)
    assert (block.xError, block.eError, block.eReason) == (True, ErrorNumber.NOT_EXECUTED, Reason.NONE)


def test_a_layout_of_a_part_that_there_is_not() -> None:
    """Nothing is ignored in silence."""
    with pytest.raises(TypeError, match="ActionClient has no part request"):
        ActionClient("/a", request=None)
