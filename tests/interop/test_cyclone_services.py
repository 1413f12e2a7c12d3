"""Services of the dds backend and a peer that does what rmw_cyclonedds' sources do (``rmw_cyclone.py``)."""

from __future__ import annotations

import struct
import threading
from collections.abc import Iterator
from typing import Any

import pytest

pytest.importorskip("cyclonedds", reason="no wheel of cyclonedds for this machine")

from cyclonedds.idl.types import sequence, uint8

from rosplc.bridge import Bridge
from rosplc.config import parse_config
from rosplc.model import TypeStore
from rosplc.ros import SERVICES, Qos, Reply, open_backend
from rosplc.ros.dds.backend import TYPES, Topics
from rosplc.shm import Namespace
from tests.interop.graphs import LOCAL, STRING, free_domain, string, text_of
from tests.interop.rmw_cyclone import HEADER, RmwClient, RmwNode, RmwServer, message_class
from tests.lib.clock import SteppedClock
from tests.lib.waiting import repeat_until, wait_for

pytestmark = [
    pytest.mark.timeout(120),
    pytest.mark.verifies("cyclone-calls", own="a peer written from rmw_cyclonedds' sources"),
]

ADD = "diagnostic_msgs/srv/AddDiagnostics"


NAME = "diagnostic_msgs/srv/AddDiagnostics_{}"
Request = message_class(NAME.format("Request"), **HEADER, load_namespace=str)
Response = message_class(NAME.format("Response"), **HEADER, success=bool, message=str)


class Node(RmwNode):
    """A participant in this process, where the backend's topics come and go."""

    def __init__(self, domain: int) -> None:
        super().__init__(domain, Topics)

    def close(self) -> None:
        with TYPES:
            self.topics.close()

    def client(self, service: str, *, complete: bool = True) -> RmwClient:
        return RmwClient(self, service, (Request, Response), complete=complete)

    def server(self, service: str) -> RmwServer:
        return RmwServer(self, service, (Request, Response))


class Cell:
    """The backend, on a stopped clock, and what its server has been asked."""

    def __init__(self, domain: int) -> None:
        self.clock = SteppedClock()
        self.asked: list[tuple[bytes, bytes]] = []
        self.backend = self._open(domain)
        self._domain = domain

    def _open(self, domain: int) -> Any:
        store = TypeStore.bundled("jazzy")
        return open_backend("dds", store, "cell", domain=domain, environment=LOCAL, clock=self.clock)

    def serve(self) -> Any:
        receive = lambda payload, caller, _: self.asked.append((payload, caller))  # noqa: E731
        return self.backend.serve("/cell/add", ADD, SERVICES, receive)

    def restart(self) -> Any:
        """Serve again as another process would."""
        before, self.backend = self.backend, self._open(self._domain)  # the last one would delete the domain
        before.close()
        return self.serve()


@pytest.fixture
def cell() -> Iterator[Cell]:
    with free_domain() as domain:
        cell = Cell(domain)
        yield cell
        cell.backend.close()


@pytest.fixture
def node(cell: Cell) -> Iterator[Node]:
    node = Node(cell.backend.domain)
    yield node
    node.close()


def response(text: str) -> bytes:
    """Return a response of TRUE and a text."""
    return b"\0\1\0\0\1\0\0\0" + string(text)[4:]


def receive(client: RmwClient, count: int = 1) -> list[tuple[int, str]]:
    """Return responses once there are as many."""
    got: list[tuple[int, str]] = []
    wait_for(
        lambda: got.extend((one.rmw_call_number, one.message) for one in client.take()) or len(got) >= count
    )
    return got


def test_a_client_calls(cell: Cell, node: Node) -> None:
    """It finds the server by its id; a caller is the client's handle and the call's number."""
    server, client = cell.serve(), node.client("/cell/add")
    wait_for(client.available)
    numbers = [client.send(f"text {number}") for number in range(8)]
    wait_for(lambda: len(cell.asked) == 8)
    assert [text_of(payload) for payload, _ in cell.asked] == [f"text {number}" for number in range(8)]
    assert [caller for _, caller in cell.asked] == [struct.pack("<Qq", client.guid, n) for n in numbers]
    for payload, caller in reversed(cell.asked):
        assert server.reply(caller, response(text_of(payload)))
    assert sorted(receive(client, 8)) == [(n, f"text {n - 1}") for n in numbers]


def test_other_clients_are_left_alone(cell: Cell, node: Node) -> None:
    """A response reaches the client whose handle it has, and no other."""
    server = cell.serve()
    one, other = node.client("/cell/add"), node.client("/cell/add")
    wait_for(lambda: one.available() and other.available() and server.matched == 2)
    one.send("one")
    other.send("other")
    wait_for(lambda: len(cell.asked) == 2)
    for payload, caller in cell.asked:
        assert server.reply(caller, response(text_of(payload)))
    assert (receive(one), receive(other)) == ([(1, "one")], [(1, "other")])


def test_a_server_is_called(cell: Cell, node: Node) -> None:
    """It is ready when both of its endpoints are matched; it gets the header, and its answers their calls."""
    server = node.server("/cell/add")
    client = cell.backend.client("/cell/add", ADD, SERVICES)
    wait_for(lambda: client.ready)
    replies: dict[str, Reply] = {}
    for number in range(8):
        client.call(string(f"text {number}"), lambda reply, n=number: replies.update({f"text {n}": reply}))
    requests: list[Any] = []
    wait_for(lambda: requests.extend(server.take()) or len(requests) == 8)
    assert len({request.rmw_client_id for request in requests}) == 1
    for request in reversed(requests):
        server.answer(request, True, request.load_namespace)
    wait_for(lambda: len(replies) == 8)
    assert all(reply.payload == response(text) for text, reply in replies.items())


def test_half_a_server_is_not_called(cell: Cell, node: Node) -> None:
    """A reader without the writer that belongs to it is not ready: nobody would answer."""
    reader = node.reader("rq/cell/addRequest", Request, node.ids("serviceid"))
    writer = node.writer("rr/cell/addReply", Response, node.ids("serviceid"))
    client: Any = cell.backend.client("/cell/add", ADD, SERVICES)
    wait_for(lambda: client.matched_handles() and client.peers(replying=True))
    replies: list[Reply] = []
    client.call(string("text"), replies.append)
    assert not client.ready
    assert [reply.outcome for reply in replies] == ["not executed"]
    assert not list(reader.take(10))
    assert writer.get_matched_subscriptions()


def test_a_response_waits_for_its_reader(cell: Cell, node: Node) -> None:
    """A client's reader that is found after the request gets the response, up to 100 ms later."""
    server: Any = cell.serve()
    client = node.client("/cell/add", complete=False)
    repeat_until(lambda: client.send("early"), lambda: cell.asked)
    assert server.reply(cell.asked[0][1], response("early"))
    client.complete()
    assert receive(client)[0][1] == "early"

    late = node.client("/cell/add", complete=False)
    before = len(cell.asked)
    repeat_until(lambda: late.send("late"), lambda: len(cell.asked) > before)
    assert server.reply(cell.asked[before][1], response("late"))
    assert server.status().dropped == 0
    cell.clock.advance(0.1)
    wait_for(lambda: server.status().dropped == 1)


def test_a_client_that_has_gone(cell: Cell, node: Node) -> None:
    """Its request has nobody who waits, and is not answered."""
    server, client = cell.serve(), node.client("/cell/add")
    wait_for(client.available)
    client.send("text")
    wait_for(lambda: cell.asked)
    assert server.present(cell.asked[0][1])
    del client.writer, client.reader
    wait_for(lambda: not server.present(cell.asked[0][1]))
    assert not server.reply(cell.asked[0][1], response("text"))


def test_a_server_that_was_restarted_answers(cell: Cell, node: Node) -> None:
    """The 16 bytes are enough for another process; what this one has answered it answers once."""
    cell.serve()
    client = node.client("/cell/add")
    wait_for(client.available)
    client.send("before")
    wait_for(lambda: cell.asked)
    server = cell.restart()
    caller = cell.asked[0][1]
    assert server.present(caller)
    assert server.reply(caller, response("after"))  # it waits until clients have found the server
    wait_for(lambda: client.available() and server.matched)
    cell.clock.advance(2.0)
    assert receive(client) == [(1, "after")]
    client.send("next")
    wait_for(lambda: len(cell.asked) == 2)
    assert server.reply(cell.asked[1][1], response("next"))
    assert not server.reply(cell.asked[1][1], response("next"))
    assert receive(client) == [(2, "next")]


def test_a_server_that_has_gone(cell: Cell, node: Node) -> None:
    """The fate of what it was asked is unknown; with another server there, that one may still answer."""
    client = cell.backend.client("/cell/add", ADD, SERVICES)
    one, other = node.server("/cell/add"), node.server("/cell/add")
    wait_for(lambda: client.status().matched == 2)
    replies: list[Reply] = []
    client.call(string("text"), replies.append)
    requests = wait_for(other.take)
    del one.writer, one.reader
    wait_for(lambda: client.status().matched == 1)
    assert not replies
    other.answer(requests[0], True, requests[0].load_namespace)
    wait_for(lambda: replies)
    assert replies[0].payload == response("text")
    client.call(string("text"), replies.append)
    wait_for(other.take)
    del other.writer, other.reader
    wait_for(lambda: len(replies) == 2)
    assert (replies[1].payload, replies[1].outcome) == (None, "fate unknown")


def test_a_server_that_answers_and_goes(cell: Cell, node: Node) -> None:
    """Its response counts, although it has gone before the response is looked at."""
    held, go_on = threading.Event(), threading.Event()

    def hold(_payload: bytes, _stamp_ns: int) -> None:
        held.set()
        go_on.wait()

    client: Any = cell.backend.client("/cell/add", ADD, SERVICES)
    cell.backend.subscribe("/hold", STRING, Qos(), hold)
    publisher = cell.backend.advertise("/hold", STRING, Qos())
    server = node.server("/cell/add")
    wait_for(lambda: client.ready and publisher.matched)
    replies: list[Reply] = []
    client.call(string("text"), replies.append)
    requests = wait_for(server.take)
    publisher.write(string("now"))
    held.wait()
    try:
        server.answer(requests[0], True, requests[0].load_namespace)
        del server.writer, server.reader
        wait_for(lambda: not client.matched_handles())
    finally:
        go_on.set()
    wait_for(lambda: replies)
    assert [reply.payload for reply in replies] == [response("text")]


def test_the_nodes_parameters(shm_namespace: Namespace, monkeypatch: pytest.MonkeyPatch) -> None:
    """A bridge's node answers a client of the services that ``ros2 param`` uses; the client finds it."""
    for variable, value in LOCAL.items():
        monkeypatch.setenv(variable, value)
    name = "rcl_interfaces/srv/GetParameterTypes_{}"
    asks = message_class(name.format("Request"), **HEADER, names=sequence[str])
    answers = message_class(name.format("Response"), **HEADER, types=sequence[uint8])
    text = "bridge: params\nros: {backend: dds, domain: %d}\nshm: {directory: %s}\n"
    with free_domain() as domain:
        node = Node(domain)
        try:
            with Bridge(parse_config(text % (domain, shm_namespace.directory))):
                client = RmwClient(node, "/rosplc_params/get_parameter_types", (asks, answers))
                wait_for(client.available)
                client.send(["bridge", "topics"])
                got: list[Any] = []
                wait_for(lambda: got.extend(client.take()) or got)
                assert list(got[0].types) == [4, 9]
        finally:
            node.close()
