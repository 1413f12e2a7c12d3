"""Services of the dds backend and a peer that does what rmw_cyclonedds' sources do, in plain Cyclone DDS.

The peer is written from ``rmw_node.cpp`` and ``serdata.hpp``: the header before the fields, the ids in the
user data, how a client finds a server, and how a server waits for a client's reader.
"""

from __future__ import annotations

import itertools
import struct
import threading
from collections.abc import Iterator
from typing import Any

import pytest

pytest.importorskip("cyclonedds", reason="no wheel of cyclonedds for this machine")

from cyclonedds.core import Policy
from cyclonedds.core import Qos as DdsQos
from cyclonedds.domain import DomainParticipant
from cyclonedds.idl import make_idl_struct
from cyclonedds.idl.types import int64, uint64
from cyclonedds.pub import DataWriter
from cyclonedds.sub import DataReader

from rosplc.model import TypeStore
from rosplc.ros import SERVICES, Qos, Reply, open_backend
from rosplc.ros.dds.domain import TYPES, Topics
from tests.interop.graphs import LOCAL, STRING, free_domain, string, text_of
from tests.lib.clock import SteppedClock
from tests.lib.waiting import repeat_until, wait_for

pytestmark = pytest.mark.timeout(120)

ADD = "diagnostic_msgs/srv/AddDiagnostics"


HEADER: dict[str, Any] = {"rmw_client_id": uint64, "rmw_call_number": int64}
NAME = "diagnostic_msgs.srv.dds_.AddDiagnostics_{}_"
Request: Any = make_idl_struct("Request_", NAME.format("Request"), {**HEADER, "load_namespace": str})
Response: Any = make_idl_struct(
    "Response_", NAME.format("Response"), {**HEADER, "success": bool, "message": str}
)
for kind in (Request, Response):
    kind.__idl_annotations__["extensibility"] = "final"


class RmwNode:
    """A participant of rmw_cyclonedds."""

    def __init__(self, domain: int) -> None:
        self.participant = DomainParticipant(domain)
        self._topics = Topics(self.participant)
        self._numbers = itertools.count(1)

    def ids(self, role: str) -> DdsQos:
        """Return the settings of the two endpoints of a client or server."""
        octets = self.participant.guid.bytes[:12] + next(self._numbers).to_bytes(4, "big")
        text = f"{octets[0]:2x}" + "".join(f".{octet:x}" for octet in octets[1:])
        return DdsQos(
            Policy.Reliability.Reliable(10**9),
            Policy.History.KeepLast(10),
            Policy.DataRepresentation(use_cdrv0_representation=True),
            Policy.Userdata(f"{role}={text};".encode()),
        )

    def writer(self, topic: str, kind: Any, qos: DdsQos) -> DataWriter[Any]:
        return DataWriter(self.participant, self._topics(topic, kind), qos)

    def reader(self, topic: str, kind: Any, qos: DdsQos) -> DataReader[Any]:
        return DataReader(self.participant, self._topics(topic, kind), qos)

    def close(self) -> None:
        with TYPES:
            self._topics.close()


def user_data(endpoint: Any) -> dict[str, str]:
    """Return what an endpoint announces beside its settings."""
    text = "" if endpoint is None else bytes(endpoint.qos[Policy.Userdata].data).decode()
    return dict(part.split("=", 1) for part in text.split(";") if "=" in part)


class RmwClient:
    """What rmw_create_client makes; the reply reader may come later, to see what a server does then."""

    def __init__(self, node: RmwNode, service: str, *, complete: bool = True) -> None:
        self._node, self._service, self._qos = node, service, node.ids("clientid")
        self.writer = node.writer(f"rq{service}Request", Request, self._qos)
        self.guid = self.writer.get_instance_handle() % 2**64
        self._sequence = itertools.count(1)
        if complete:
            self.complete()

    def complete(self) -> None:
        self.reader = self._node.reader(f"rr{self._service}Reply", Response, self._qos)

    def available(self) -> bool:
        """Return what rmw_service_server_is_available does (check_for_service_reader_writer)."""
        readers = map(self.writer.get_matched_subscription_data, self.writer.get_matched_subscriptions())
        wanted = {user_data(one)["serviceid"] for one in readers if "serviceid" in user_data(one)}
        writers = map(self.reader.get_matched_publication_data, self.reader.get_matched_publications())
        return any(user_data(one).get("serviceid") in wanted for one in writers)

    def send(self, text: str) -> int:
        number = next(self._sequence)
        self.writer.write(Request(self.guid, number, text))
        return number

    def take(self) -> list[tuple[int, str]]:
        """Return number and text of the responses to this client (rmw_take_response)."""
        return [
            (one.rmw_call_number, one.message)
            for one in self.reader.take(100)
            if one.rmw_client_id == self.guid
        ]


class RmwServer:
    """What rmw_create_service makes."""

    def __init__(self, node: RmwNode, service: str) -> None:
        qos = node.ids("serviceid")
        self.writer = node.writer(f"rr{service}Reply", Response, qos)
        self.reader = node.reader(f"rq{service}Request", Request, qos)

    def take(self) -> list[Any]:
        return list(self.reader.take(100))

    def reached(self, request: Any) -> bool:
        """Return whether the client's reader is matched (check_for_response_reader)."""
        client = self.reader.get_matched_publication_data(request.sample_info.publication_handle)
        readers = map(self.writer.get_matched_subscription_data, self.writer.get_matched_subscriptions())
        return user_data(client)["clientid"] in [user_data(one).get("clientid") for one in readers]

    def answer(self, request: Any) -> None:
        wait_for(lambda: self.reached(request))
        self.writer.write(
            Response(request.rmw_client_id, request.rmw_call_number, True, request.load_namespace)
        )


class Cell:
    """The backend, on a clock that stands still, and what its server has been asked."""

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
def node(cell: Cell) -> Iterator[RmwNode]:
    node = RmwNode(cell.backend.domain)
    yield node
    node.close()


def response(text: str) -> bytes:
    """Return a response of TRUE and a text."""
    return b"\0\1\0\0\1\0\0\0" + string(text)[4:]


def receive(client: RmwClient, count: int = 1) -> list[tuple[int, str]]:
    """Return responses once there are as many."""
    got: list[tuple[int, str]] = []
    wait_for(lambda: got.extend(client.take()) or len(got) >= count)
    return got


def test_a_client_calls(cell: Cell, node: RmwNode) -> None:
    """It finds the server by its id; a caller is the client's handle and the call's number."""
    server, client = cell.serve(), RmwClient(node, "/cell/add")
    wait_for(client.available)
    numbers = [client.send(f"text {number}") for number in range(8)]
    wait_for(lambda: len(cell.asked) == 8)
    assert [text_of(payload) for payload, _ in cell.asked] == [f"text {number}" for number in range(8)]
    assert [caller for _, caller in cell.asked] == [struct.pack("<Qq", client.guid, n) for n in numbers]
    for payload, caller in reversed(cell.asked):
        assert server.reply(caller, response(text_of(payload)))
    assert sorted(receive(client, 8)) == [(n, f"text {n - 1}") for n in numbers]


def test_other_clients_are_left_alone(cell: Cell, node: RmwNode) -> None:
    """A response reaches the client whose handle it has, and no other."""
    server = cell.serve()
    one, other = RmwClient(node, "/cell/add"), RmwClient(node, "/cell/add")
    wait_for(lambda: one.available() and other.available() and server.matched == 2)
    one.send("one")
    other.send("other")
    wait_for(lambda: len(cell.asked) == 2)
    for payload, caller in cell.asked:
        assert server.reply(caller, response(text_of(payload)))
    assert (receive(one), receive(other)) == ([(1, "one")], [(1, "other")])


def test_a_server_is_called(cell: Cell, node: RmwNode) -> None:
    """It is ready when both of its endpoints are matched; it gets the header, and its answers their calls."""
    server = RmwServer(node, "/cell/add")
    client = cell.backend.client("/cell/add", ADD, SERVICES)
    wait_for(lambda: client.ready)
    replies: dict[str, Reply] = {}
    for number in range(8):
        client.call(string(f"text {number}"), lambda reply, n=number: replies.update({f"text {n}": reply}))
    requests: list[Any] = []
    wait_for(lambda: requests.extend(server.take()) or len(requests) == 8)
    assert len({request.rmw_client_id for request in requests}) == 1
    for request in reversed(requests):
        server.answer(request)
    wait_for(lambda: len(replies) == 8)
    assert all(reply.payload == response(text) for text, reply in replies.items())


def test_half_a_server_is_not_called(cell: Cell, node: RmwNode) -> None:
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


def test_a_response_waits_for_its_reader(cell: Cell, node: RmwNode) -> None:
    """A client's reader that is found after the request gets the response, up to 100 ms later."""
    server: Any = cell.serve()
    client = RmwClient(node, "/cell/add", complete=False)
    repeat_until(lambda: client.send("early"), lambda: cell.asked)
    assert server.reply(cell.asked[0][1], response("early"))
    client.complete()
    assert receive(client)[0][1] == "early"

    late = RmwClient(node, "/cell/add", complete=False)
    before = len(cell.asked)
    repeat_until(lambda: late.send("late"), lambda: len(cell.asked) > before)
    assert server.reply(cell.asked[before][1], response("late"))
    assert server.status().dropped == 0
    cell.clock.advance(0.1)
    wait_for(lambda: server.status().dropped == 1)


def test_a_client_that_has_gone(cell: Cell, node: RmwNode) -> None:
    """Its request has nobody who waits, and is not answered."""
    server, client = cell.serve(), RmwClient(node, "/cell/add")
    wait_for(client.available)
    client.send("text")
    wait_for(lambda: cell.asked)
    assert server.present(cell.asked[0][1])
    del client.writer, client.reader
    wait_for(lambda: not server.present(cell.asked[0][1]))
    assert not server.reply(cell.asked[0][1], response("text"))


def test_a_server_that_was_restarted_answers(cell: Cell, node: RmwNode) -> None:
    """The 16 bytes are enough for another process; what this one has answered it answers once."""
    cell.serve()
    client = RmwClient(node, "/cell/add")
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


def test_a_server_that_has_gone(cell: Cell, node: RmwNode) -> None:
    """The fate of what it was asked is unknown; with another server there, that one may still answer."""
    client = cell.backend.client("/cell/add", ADD, SERVICES)
    one, other = RmwServer(node, "/cell/add"), RmwServer(node, "/cell/add")
    wait_for(lambda: client.status().matched == 2)
    replies: list[Reply] = []
    client.call(string("text"), replies.append)
    requests = wait_for(other.take)
    del one.writer, one.reader
    wait_for(lambda: client.status().matched == 1)
    assert not replies
    other.answer(requests[0])
    wait_for(lambda: replies)
    assert replies[0].payload == response("text")
    client.call(string("text"), replies.append)
    wait_for(other.take)
    del other.writer, other.reader
    wait_for(lambda: len(replies) == 2)
    assert (replies[1].payload, replies[1].outcome) == (None, "fate unknown")


def test_a_server_that_answers_and_goes(cell: Cell, node: RmwNode) -> None:
    """Its response counts, although it has gone before the response is looked at."""
    held, go_on = threading.Event(), threading.Event()

    def hold(_payload: bytes, _stamp_ns: int) -> None:
        held.set()
        go_on.wait()

    client: Any = cell.backend.client("/cell/add", ADD, SERVICES)
    cell.backend.subscribe("/hold", STRING, Qos(), hold)
    publisher = cell.backend.advertise("/hold", STRING, Qos())
    server = RmwServer(node, "/cell/add")
    wait_for(lambda: client.ready and publisher.matched)
    replies: list[Reply] = []
    client.call(string("text"), replies.append)
    requests = wait_for(server.take)
    publisher.write(string("now"))
    held.wait()
    try:
        server.answer(requests[0])
        del server.writer, server.reader
        wait_for(lambda: not client.matched_handles())
    finally:
        go_on.set()
    wait_for(lambda: replies)
    assert [reply.payload for reply in replies] == [response("text")]
