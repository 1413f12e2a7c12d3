"""Services on rclpy, over its double: answers that come later, what ends a call, what a peer has."""

from __future__ import annotations

import importlib.util
import struct
from collections.abc import Iterator
from typing import Any

import pytest

from rosplc.errors import BackendError
from rosplc.model import TypeStore
from rosplc.reasons import Reason
from rosplc.ros import SERVICES, Reply, open_backend
from tests.doubles.ros2 import double, installed
from tests.lib.waiting import wait_for

pytestmark = [
    pytest.mark.needs(when=importlib.util.find_spec("rclpy") is None, why="the real rclpy is here"),
]

SET_BOOL = "std_srvs/srv/SetBool"
YES, NO = b"\0\1\0\0\1\0\0\0", b"\0\1\0\0\0\0\0\0"


def response(success: bool, message: str) -> bytes:
    data = message.encode() + b"\0"
    return b"\0\1\0\0" + struct.pack("<BxxxI", success, len(data)) + data + bytes(-len(data) % 4)


@pytest.fixture(params=["jazzy", "humble"])
def machine(request: pytest.FixtureRequest) -> Iterator[str]:
    with double(request.param):
        yield request.param


@pytest.fixture
def nodes(machine: str) -> Iterator[Any]:
    """Give a function that opens nodes of one domain."""
    opened: list[Any] = []

    def open_node(name: str) -> Any:
        opened.append(open_backend("rclpy", TypeStore.bundled(machine), name, domain=7))
        return opened[-1]

    yield open_node
    for node in opened:
        node.close()


class Requests:
    """Requests that wait for their answers."""

    def __init__(self) -> None:
        self.open: list[tuple[bytes, bytes, int]] = []

    def __call__(self, *request: Any) -> None:
        self.open.append(request)


def test_answers_come_later_and_in_any_order(nodes: Any) -> None:
    """A request waits for its answer without keeping others waiting; each is answered once."""
    requests, replies = Requests(), dict[int, list[Reply]]()
    server = nodes("cell").serve("start", SET_BOOL, SERVICES, requests)
    client = nodes("robot").client("/start", SET_BOOL, SERVICES)
    assert server.topic == client.topic == "/start"
    wait_for(lambda: client.ready)
    for number in range(10):
        client.call(YES if number % 2 else NO, replies.setdefault(number, []).append)
    wait_for(lambda: len(requests.open) == 10)
    assert [payload for payload, _, _ in requests.open] == [NO, YES] * 5
    assert len({caller for _, caller, _ in requests.open}) == 10
    for number, (payload, caller, stamp) in reversed(list(enumerate(requests.open))):
        assert len(caller) == 16
        assert stamp > 0
        assert server.present(caller)
        assert server.reply(caller, response(payload == YES, f"number {number}"))
        assert not server.present(caller)
        assert not server.reply(caller, response(True, "twice"))
    wait_for(lambda: all(replies.values()))
    assert {number: one for number, (one,) in replies.items()} == {
        number: Reply(response(number % 2 == 1, f"number {number}")) for number in range(10)
    }
    assert (server.status().received, client.status().sent) == (10, 10)
    assert server.matched == client.matched == 1
    assert not server.remembers


def test_a_server_that_leaves_ends_its_calls(nodes: Any) -> None:
    """The fate of open calls is unknown, and the next is not executed."""
    requests, replies = Requests(), list[Reply]()
    server = nodes("cell").serve("/start", SET_BOOL, SERVICES, requests)
    client = nodes("robot").client("/start", SET_BOOL, SERVICES)
    client.call(YES, replies.append)
    wait_for(lambda: requests.open)
    server.close()
    wait_for(lambda: replies)
    assert (replies[0].outcome, replies[0].reason) == ("fate unknown", Reason.SERVER_GONE)
    client.call(YES, replies.append)
    assert (replies[1].outcome, replies[1].reason) == ("not executed", Reason.NO_SERVER)
    assert client.status().reason == "no node serves /start"
    with pytest.raises(BackendError, match="ROS009"):
        server.reply(requests.open[0][1], YES)


def test_a_refused_or_forgotten_call_gets_no_answer(nodes: Any) -> None:
    """Both are forgotten; a response that comes anyway is counted as late."""
    requests, replies = Requests(), list[Reply]()
    server = nodes("cell").serve("/start", SET_BOOL, SERVICES, requests)
    client = nodes("robot").client("/start", SET_BOOL, SERVICES)
    number = client.call(YES, replies.append)
    client.call(YES, replies.append)
    wait_for(lambda: len(requests.open) == 2)
    client.forget(number)
    assert server.reply(requests.open[0][1], response(True, "late"))
    assert server.refuse(requests.open[1][1], "the queue is full")
    assert not server.refuse(requests.open[1][1], "the queue is full")
    client.close()
    assert [(one.payload, one.outcome) for one in replies] == [(None, "fate unknown")]
    with pytest.raises(BackendError, match="ROS009"):
        client.call(YES, replies.append)


def test_a_request_that_cannot_be_taken_ends_nothing(nodes: Any) -> None:
    """It is counted; the next is served. The same holds for a response."""
    cell, robot = nodes("cell"), nodes("robot")
    requests, replies = Requests(), list[Reply]()
    server = cell.serve("/start", SET_BOOL, SERVICES, requests)
    client = robot.client("/start", SET_BOOL, SERVICES)
    client.entity.handle.writer.send(b"", client=(0, 0))
    wait_for(lambda: server.status().rejected == 1)
    server.entity.handle.writer.send(b"", client=(client.entity.handle.writer.number, 1))
    wait_for(lambda: client.status().rejected == 1)
    client.call(YES, replies.append)
    wait_for(lambda: requests.open)
    server.reply(requests.open[0][1], response(True, "done"))
    wait_for(lambda: replies)


def test_what_is_no_message_is_refused(nodes: Any) -> None:
    """A payload without a header of plain CDR is not sent, and what the middleware refuses is an error."""
    server = nodes("cell").serve("/start", SET_BOOL, SERVICES, requests := Requests())
    client = nodes("robot").client("/start", SET_BOOL, SERVICES)
    with pytest.raises(BackendError, match="ROS008"):
        client.call(b"", print)
    client.call(YES, print)
    wait_for(lambda: requests.open)
    with pytest.raises(BackendError, match="ROS008"):
        server.reply(requests.open[0][1], b"")
    from rclpy import _graph

    _graph.unsupported.add("publish")
    try:
        with pytest.raises(BackendError, match="ROS002"):
            server.reply(requests.open[0][1], YES)
        with pytest.raises(BackendError, match="ROS002"):
            client.call(YES, print)
    finally:
        _graph.unsupported.clear()


def test_another_type_and_another_server_are_reported(nodes: Any) -> None:
    """A server of another type is named; several of the right type are, too."""
    cell, robot = nodes("cell"), nodes("robot")
    client = robot.client("/start", SET_BOOL, SERVICES)
    wrong = cell.serve("/start", "std_srvs/srv/Trigger", SERVICES, Requests())
    assert client.status().code == "ROS003"
    assert "node /cell serves /start as std_srvs/srv/Trigger" in client.status().reason
    assert "node /robot calls /start as std_srvs/srv/SetBool" in wrong.status().reason
    assert not client.ready
    wrong.close()
    wait_for(lambda: client.status().code == "")
    cell.serve("/start", SET_BOOL, SERVICES, Requests())
    wait_for(lambda: client.ready)
    nodes("other").serve("/start", SET_BOOL, SERVICES, Requests())
    assert client.status().code == "ROS022"
    assert "node /cell; node /other" in client.status().reason


def test_a_service_that_is_not_installed(nodes: Any, machine: str) -> None:
    """The error names what is missing, and what differs."""
    node = nodes("cell")
    with installed(TypeStore.bundled(machine), {"std_srvs"}), pytest.raises(BackendError, match="ROS011"):
        node.serve("/start", SET_BOOL, SERVICES, print)
