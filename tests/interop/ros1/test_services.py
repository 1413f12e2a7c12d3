"""Services of ROS 1: rospy and rosservice call the backend's servers, and a server of rospy is called."""

from __future__ import annotations

import contextlib
import socket
import struct
import threading
from collections.abc import Iterator
from typing import Any

import pytest

from rosplc.errors import BackendError
from rosplc.model import TypeStore
from rosplc.reasons import Reason
from rosplc.ros import SERVICES, Backend, Reply, open_backend
from rosplc.ros.rospy import services
from rosplc.ros.rospy.handshake import encode_header, read_header
from rosplc.ros.rospy.master import Master
from tests.interop.ros1.graph import PACKAGES, Graph, lend
from tests.lib.waiting import repeat_until, wait_for

pytestmark = [
    pytest.mark.needs(*PACKAGES),
    pytest.mark.timeout(120),
    pytest.mark.verifies("ros1", real="rospy, roscpp"),
]

STORE = TypeStore.bundled("noetic")
SET_BOOL = "std_srvs/srv/SetBool"


@pytest.fixture
def ros1() -> Iterator[Graph]:
    with lend() as graph:
        yield graph


@pytest.fixture
def cell(ros1: Graph) -> Iterator[Backend]:
    backend = open_backend("rospy", STORE, "cell", environment=ros1.environment)
    yield backend
    backend.close()


def response(success: bool, message: str) -> bytes:
    return struct.pack("<BI", success, len(message)) + message.encode()


class Requests:
    """A receiver of requests; ``answer`` says what becomes of each at once, None keeps it open."""

    def __init__(self, answer: str | None = "reply") -> None:
        self.answer = answer
        self.open: list[tuple[bytes, bytes]] = []
        self.server: Any = None

    def __call__(self, payload: bytes, caller: bytes, stamp_ns: int) -> None:
        self.open.append((payload, caller))
        if self.answer == "reply":
            assert self.server.reply(caller, response(payload == b"\1", "done"))
        elif self.answer == "refuse":
            assert self.server.refuse(caller, "the PLC is down")


def serve(cell: Backend, ros1: Graph, answer: str | None = "reply", service: str = "/start") -> Requests:
    """Serve a service, registered when this returns."""
    requests = Requests(answer)
    requests.server = cell.serve(service, SET_BOOL, SERVICES, requests)
    wait_for(lambda: service in ros1.run("rosservice", "list").split())
    return requests


def called(cell: Backend, service: str = "/start") -> Any:
    """Return a client whose server is known."""
    client = cell.client(service, SET_BOOL, SERVICES)
    wait_for(lambda: client.ready, "the server")
    return client


def test_tools_see_and_call_a_server(ros1: Graph, cell: Backend) -> None:
    """``rosservice`` lists the service with node, type and arguments, and calls it."""
    requests = serve(cell, ros1)
    assert ros1.run("rosservice", "type", "/start").strip() == "std_srvs/SetBool"
    assert ros1.run("rosservice", "node", "/start").strip() == "/cell"
    assert "Args: data" in ros1.run("rosservice", "info", "/start")
    assert ros1.run("rosservice", "find", "std_srvs/SetBool").split() == ["/start"]
    assert "done" in ros1.run("rosservice", "call", "/start", "true")
    assert "/start" in ros1.run("rosnode", "info", "/cell")
    requests.server.close()
    wait_for(lambda: "/start" not in ros1.run("rosservice", "list").split())


@pytest.mark.parametrize("persistent", [False, True])
def test_a_proxy_gets_answers_and_errors(ros1: Graph, cell: Backend, persistent: bool) -> None:
    """A proxy of rospy gets the response; a refusal reaches it as an error with its text."""
    requests = serve(cell, ros1)
    proxy = ros1.peer("rospy", "peer").proxy("/start", SET_BOOL, persistent)
    for number, data in enumerate([b"\1", b"\0", b"\1"], 1):
        proxy.call(data)
        wait_for(lambda n=number: len(proxy.replies) == n)
    assert proxy.replies == [response(data, "done") for data in (True, False, True)]
    requests.answer = "refuse"
    proxy.call(b"\1")
    wait_for(lambda: proxy.errors)
    assert b"the PLC is down" in proxy.errors[0]
    assert requests.server.status().received == 4
    assert requests.server.matched == persistent


def test_answers_come_later_and_in_any_order(ros1: Graph, cell: Backend) -> None:
    """Many callers wait at once; each gets its own answer, once."""
    requests = serve(cell, ros1, None)
    peers = [ros1.peer("rospy", f"peer{number}") for number in range(2)]
    proxies = [peer.proxy("/start", SET_BOOL) for peer in peers]
    for proxy in proxies * 4:
        proxy.call(b"\1")
    wait_for(lambda: len(requests.open) == 8)
    server = requests.server
    for number, (_, caller) in enumerate(reversed(requests.open)):
        assert server.present(caller)
        assert server.reply(caller, response(True, f"number {number}"))
        assert not server.present(caller)
        assert not server.reply(caller, response(True, "twice"))
        assert not server.refuse(caller, "twice")
    wait_for(lambda: sum(len(proxy.replies) for proxy in proxies) == 8)
    texts = [reply[5:].decode() for proxy in proxies for reply in proxy.replies]
    assert sorted(texts) == [f"number {number}" for number in range(8)]
    assert not server.reply(bytes(16), response(True, "nobody"))


def test_a_caller_that_is_killed_is_not_present(ros1: Graph, cell: Backend) -> None:
    """Its request cannot be answered any more; others are served on."""
    requests = serve(cell, ros1, None)
    peer = ros1.peer("rospy", "peer")
    peer.proxy("/start", SET_BOOL).call(b"\1")
    ((_, caller),) = wait_for(lambda: requests.open)
    peer.kill()
    wait_for(lambda: not requests.server.present(caller))
    assert not requests.server.reply(caller, response(True, "late"))
    requests.answer = "reply"
    assert "done" in ros1.run("rosservice", "call", "/start", "true")


def test_a_server_that_closes_ends_its_callers(ros1: Graph, cell: Backend) -> None:
    """Callers that wait get an error at once; a reply to them is an error here."""
    requests = serve(cell, ros1, None)
    proxy = ros1.peer("rospy", "peer").proxy("/start", SET_BOOL)
    proxy.call(b"\1")
    ((_, caller),) = wait_for(lambda: requests.open)
    requests.server.close()
    wait_for(lambda: proxy.errors)
    assert b"no longer served" in proxy.errors[0]
    with pytest.raises(BackendError, match="ROS009"):
        requests.server.reply(caller, response(True, "late"))


def test_a_defect_ends_the_call_that_meets_it(
    ros1: Graph, cell: Backend, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Its caller does not wait without end, and the next one is served."""
    requests = serve(cell, ros1)
    proxy = ros1.peer("rospy", "peer").proxy("/start", SET_BOOL)
    with monkeypatch.context() as patch:
        patch.setattr(services.RospyServer, "receive", lambda *_: 1 / 0)
        proxy.call(b"\1")
        wait_for(lambda: proxy.errors)
    proxy.call(b"\1")
    wait_for(lambda: proxy.replies)
    assert requests.server.status().received == 1


def test_a_server_of_rospy_is_called(ros1: Graph, cell: Backend) -> None:
    """A call of a rospy.Service gets its response; its failure comes with its own words."""
    peer = ros1.peer("rospy", "peer")
    heard = peer.serve("/start", SET_BOOL)
    client = called(cell)
    replies: list[Reply] = []
    client.call(b"\1", replies.append)
    wait_for(lambda: len(replies) == 1)
    client.call(b"\0", replies.append)
    wait_for(lambda: len(replies) == 2)
    assert replies[0] == Reply(response(True, "done"))
    assert replies[1].payload is None
    assert (replies[1].outcome, replies[1].reason) == ("fate unknown", Reason.SERVER_FAILED)
    assert "not now" in replies[1].text
    assert heard == [b"\1", b"\0"]
    assert client.status().sent == 2


def test_calls_at_once(ros1: Graph, cell: Backend) -> None:
    """Calls from several threads each get one answer; beyond the limit they are not executed."""
    serve(cell, ros1, None, "/silent")
    client = called(cell, "/silent")
    replies: list[Reply] = []
    threads = [
        threading.Thread(target=client.call, args=(b"\1", replies.append)) for _ in range(services.MOST_CALLS)
    ]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert not replies
    client.call(b"\1", replies.append)
    assert [(one.outcome, one.reason) for one in replies] == [("not executed", Reason.QUEUE_FULL)]
    client.close()
    assert len(replies) == services.MOST_CALLS + 1
    assert {one.outcome for one in replies[1:]} == {"fate unknown"}


def test_without_a_server_nothing_is_executed(ros1: Graph, cell: Backend) -> None:
    """A call without a server, or with one of another type, ends at once as not executed."""
    client = cell.client("/start", SET_BOOL, SERVICES)
    replies: list[Reply] = []
    client.call(b"\1", replies.append)
    assert [(one.outcome, one.reason) for one in replies] == [("not executed", Reason.NO_SERVER)]
    assert client.status().reason == "no node serves /start"
    ros1.peer("rospy", "peer").serve("/start", "std_srvs/srv/Trigger")
    wait_for(lambda: client.status().code == "ROS003")
    assert "node /peer serves /start as std_srvs/srv/Trigger" in client.status().reason
    assert not client.ready


def test_a_server_that_is_killed(ros1: Graph, cell: Backend) -> None:
    """The open call's fate is unknown, the next is not executed, and a successor is found."""
    peer = ros1.peer("rospy", "peer")
    heard = peer.serve("/silent", SET_BOOL)
    client = called(cell, "/silent")
    replies: list[Reply] = []
    client.call(b"\1", replies.append)
    wait_for(lambda: heard)
    peer.kill()
    wait_for(lambda: replies)
    assert (replies[0].outcome, replies[0].reason) == ("fate unknown", Reason.SERVER_GONE)
    client.call(b"\1", replies.append)
    wait_for(lambda: len(replies) == 2)
    assert (replies[1].outcome, replies[1].reason) == ("not executed", Reason.NO_SERVER)
    heard = ros1.peer("rospy", "peer").serve("/silent", SET_BOOL)
    repeat_until(lambda: client.call(b"\1", replies.append), lambda: heard)


def test_a_forgotten_call_hears_nothing(ros1: Graph, cell: Backend) -> None:
    """Its connection is closed, so that the server learns it."""
    requests = serve(cell, ros1, None)
    client = called(cell)
    replies: list[Reply] = []
    number = client.call(b"\1", replies.append)
    ((_, caller),) = wait_for(lambda: requests.open)
    client.forget(number)
    client.forget(number)
    wait_for(lambda: not requests.server.present(caller))
    client.close()
    assert not replies


def test_a_service_that_another_node_takes(ros1: Graph, cell: Backend) -> None:
    """The newer server gets the calls, as in ROS 1; the status tells, and the service comes back."""
    requests = serve(cell, ros1)
    peer = ros1.peer("rospy", "peer")
    peer.serve("/start", SET_BOOL)
    wait_for(lambda: requests.server.status().code == "ROS022")
    assert "node /peer has taken over /start" in requests.server.status().reason
    peer.unserve("/start")
    wait_for(lambda: "/start" in ros1.run("rosservice", "list").split())
    assert ros1.run("rosservice", "node", "/start").strip() == "/cell"
    with pytest.raises(BackendError, match="already serves /start"):
        cell.serve("/start", SET_BOOL, SERVICES, requests)


def test_a_new_master_learns_of_the_service(ros1: Graph, cell: Backend) -> None:
    """A master that was restarted is told again."""
    serve(cell, ros1)
    ros1.kill_master()
    ros1.start_master()
    wait_for(lambda: "/start" in ros1.run("rosservice", "list").split())


HOSTILE = {
    "nothing": b"",
    "half a length": b"\1\0",
    "half a request": b"\5\0\0\0\1",
    "a length without end": b"\xff\xff\xff\xff",
}


@pytest.mark.parametrize("data", HOSTILE.values(), ids=HOSTILE)
def test_hostile_callers_are_dropped(
    ros1: Graph, cell: Backend, data: bytes, monkeypatch: pytest.MonkeyPatch
) -> None:
    """What is no request, or never becomes one, ends the connection; the others are served on."""
    requests = serve(cell, ros1)
    place = Master(ros1.environment["ROS_MASTER_URI"], "/rogue").service_place("/start")
    with monkeypatch.context() as patch, socket.create_connection(place) as sock:
        patch.setattr(services, "_STUCK_S", 0.5)
        header = {"callerid": "/rogue", "service": "/start", "md5sum": "*"}
        sock.sendall(encode_header(header))
        assert read_header(sock, 5.0)["type"] == "std_srvs/SetBool"
        sock.sendall(data)
        sock.settimeout(60.0)
        with contextlib.suppress(ConnectionResetError):
            assert sock.recv(1) == b""
    assert not requests.open
    assert "done" in ros1.run("rosservice", "call", "/start", "true")


def test_a_caller_that_takes_no_answer(ros1: Graph, cell: Backend, monkeypatch: pytest.MonkeyPatch) -> None:
    """An answer that does not fit its connection waits for it without blocking anybody, and not for ever."""
    requests = serve(cell, ros1, None)
    place = Master(ros1.environment["ROS_MASTER_URI"], "/rogue").service_place("/start")
    fields = {"callerid": "/rogue", "service": "/start", "md5sum": STORE.service_md5(SET_BOOL)}
    with contextlib.ExitStack() as stack:
        for number, patience_s in enumerate((3600.0, 0.5), 1):
            monkeypatch.setattr(services, "_STUCK_S", patience_s)
            sock = stack.enter_context(socket.create_connection(place))
            sock.sendall(encode_header({**fields, "persistent": "1"}))
            read_header(sock, 5.0)
            sock.sendall(b"\1\0\0\0\1")
            wait_for(lambda n=number: len(requests.open) == n)
            assert requests.server.reply(requests.open[-1][1], response(True, "x" * (32 << 20)))
        wait_for(lambda: requests.server.matched == 1)
        monkeypatch.undo()
        requests.answer = "reply"
        assert "done" in ros1.run("rosservice", "call", "/start", "true")
        assert requests.server.matched == 1


def test_a_wrong_md5sum_is_refused(ros1: Graph, cell: Backend) -> None:
    """A caller with another definition gets an error, and is counted."""
    requests = serve(cell, ros1)
    place = Master(ros1.environment["ROS_MASTER_URI"], "/rogue").service_place("/start")
    with socket.create_connection(place) as sock:
        sock.sendall(encode_header({"callerid": "/rogue", "service": "/start", "md5sum": "0" * 32}))
        assert "md5sum" in read_header(sock, 5.0)["error"]
    assert requests.server.status().rejected == 1
