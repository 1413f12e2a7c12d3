"""What every ROS backend does alike with services; the harnesses are those of ``test_backends.py``.

Requests and responses are those of ``diagnostic_msgs/srv/AddDiagnostics``, which both ROS have: a text,
and a flag with a text.
"""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from typing import Any

import pytest

from rosplc.errors import RosplcError
from rosplc.reasons import Reason
from rosplc.ros import Reply
from tests.conformance.backends.base import STRING, Harness
from tests.conformance.backends.node import echo
from tests.conformance.test_backends import graph, over
from tests.lib.waiting import wait_for

__all__ = ["graph"]  # the fixture

pytestmark = pytest.mark.timeout(120)

ADD = "diagnostic_msgs/srv/AddDiagnostics"
EMPTY = "std_srvs/srv/Empty"


def connect(graph: Harness, receiver: str = "echo", service: str = "/cell/add") -> tuple[Any, Any]:
    """Return a server and a client of a service, matched."""
    server = graph.node("server").serve(service, ADD, receiver)
    client = graph.node("client").client(service, ADD)
    wait_for(client.ready)
    return server, client


def answered(graph: Harness, client: Any, text: str) -> str:
    """Call, and return the text of the response."""
    place = client.call(graph.string(text))
    return text_of(graph, wait_for(lambda: dict(client.replies()).get(place)))


def text_of(graph: Harness, reply: Reply) -> str:
    """Return the text of a response."""
    assert reply.payload is not None, reply
    if graph.ros1:
        return graph.text(reply.payload[1:])
    return graph.text(reply.payload[:4] + reply.payload[8:])


def asked(server: Any, count: int = 1) -> list[tuple[bytes, bytes, int]]:
    """Return the requests once there are as many."""
    wait_for(lambda: len(server.requests()) >= count)
    found: list[tuple[bytes, bytes, int]] = server.requests()
    return found


def test_the_graph_shows_services(graph: Harness) -> None:
    """The other nodes' servers and clients, apart from the topics; one's own are left out."""
    server, client = connect(graph)
    node = graph.node("onlooker")
    ends = 1 if graph.ros1 else 2

    def seen() -> list[Any]:
        found = [end for end in node.graph().services if end.topic == "/cell/add"]
        return found if len(found) == ends and all(end.node for end in found) else []

    found = {end.direction: end for end in wait_for(seen)}
    assert found["in"].node == "/server"
    if not graph.ros1:
        assert (found["out"].node, found["in"].type_name, found["out"].type_name) == ("/client", ADD, ADD)
    assert "/cell/add" not in node.graph().topics
    del server, client


def test_a_call_is_answered(graph: Harness) -> None:
    """Request and response arrive as they were sent, and both ends count them."""
    server, client = connect(graph)
    assert answered(graph, client, "lift") == "lift"
    ((payload, caller, _),) = server.requests()
    assert (graph.text(payload), len(caller)) == ("lift", 16)
    assert (server.status().messages, client.status().messages) == (1, 1)
    assert (server.status().direction, client.status().direction) == ("in", "out")
    assert server.remembers() == graph.abilities.remembers_callers
    assert client.status().matched == 1
    assert (server.status().code, client.status().code) == ("", "")


def test_each_caller_gets_its_own_answer(graph: Harness) -> None:
    """Many calls of several clients at once, in two processes: no answer is lost or another's."""
    graph.node("server").serve("/cell/add", ADD, "echo")
    nodes = [graph.node("one"), graph.node("one_more"), graph.other("other")]
    clients = [node.client("/cell/add", ADD) for node in nodes]
    wait_for(lambda: all(client.ready() for client in clients))
    texts = [[f"{which}:{number}" for number in range(60)] for which in range(len(clients))]
    with ThreadPoolExecutor(len(clients)) as pool:
        for client, own in zip(clients, texts, strict=True):
            pool.submit(client.call_all, [graph.string(text) for text in own])
    for client, own in zip(clients, texts, strict=True):
        wait_for(lambda c=client: len(c.replies()) == 60)
        assert [text_of(graph, reply) for _, reply in sorted(client.replies(), key=lambda r: r[0])] == own


def test_answers_may_come_in_any_order(graph: Harness) -> None:
    """The last request is answered first, and each answer reaches its call; none is given twice."""
    server, client = connect(graph, "keep")
    client.call_all([graph.string(str(number)) for number in range(5)])
    for payload, caller, _ in reversed(asked(server, 5)):
        assert server.present(caller)
        assert server.reply(caller, echo(payload, graph.ros1))
        assert not server.reply(caller, echo(payload, graph.ros1))
        wait_for(lambda p=payload: graph.text(p) in {text_of(graph, reply) for _, reply in client.replies()})
    assert sorted((place, text_of(graph, r)) for place, r in client.replies()) == [
        (number, str(number)) for number in range(5)
    ]


def test_without_a_server_nothing_is_executed(graph: Harness) -> None:
    """The call ends at once, and says that it is safe to call again; the status names what is missing."""
    client = graph.node("client").client("/cell/add", ADD)
    assert not client.ready()
    client.call(graph.string("nobody"))
    ((_, reply),) = wait_for(client.replies)
    assert (reply.payload, reply.outcome, reply.reason) == (None, "not executed", Reason.NO_SERVER)
    wait_for(lambda: client.status().reason == "no node serves /cell/add")
    server = graph.other("server").serve("/cell/add", ADD)
    if graph.abilities.sees_callers and not graph.ros1:
        wait_for(server.matched)
    wait_for(client.ready)
    assert answered(graph, client, "now") == "now"
    assert client.status().reason == ""


def test_a_forgotten_call_stays_silent(graph: Harness) -> None:
    """A response that comes after its call was forgotten reaches nobody; the client goes on."""
    server, client = connect(graph, "keep")
    forgotten = client.call(graph.string("forgotten"))
    ((payload, caller, _),) = asked(server)
    client.forget(forgotten)
    server.reply(caller, echo(payload, graph.ros1))
    place = client.call(graph.string("next"))
    payload, caller, _ = asked(server, 2)[1]
    server.reply(caller, echo(payload, graph.ros1))
    wait_for(client.replies)
    assert [which for which, _ in client.replies()] == [place]


def test_a_server_that_closes(graph: Harness) -> None:
    """What it had not answered may have been executed: the fate of such a call is unknown."""
    server, client = connect(graph, "keep")
    client.call(graph.string("open"))
    asked(server)
    server.close()
    ((_, reply),) = wait_for(client.replies)
    assert (reply.payload, reply.outcome) == (None, "fate unknown")
    wait_for(lambda: not client.ready())


@over(lambda harness: harness.reaches_out)
def test_a_server_that_dies(graph: Harness) -> None:
    """A server that was killed answers nothing more; the next one is found and called."""
    node = graph.process("server")
    server = node.serve("/cell/add", ADD, "keep")
    client = graph.node("client").client("/cell/add", ADD)
    wait_for(client.ready)
    client.call(graph.string("open"))
    asked(server)
    node.kill()
    ((_, reply),) = wait_for(client.replies)
    assert (reply.payload, reply.outcome) == (None, "fate unknown")
    wait_for(lambda: not client.ready())
    graph.process("next").serve("/cell/add", ADD)
    wait_for(client.ready)
    assert answered(graph, client, "again") == "again"


def test_a_client_that_closes(graph: Harness) -> None:
    """Each open call ends once, with an unknown fate; nothing comes after the close."""
    server, client = connect(graph, "keep")
    client.call_all([graph.string(str(number)) for number in range(3)])
    requests = asked(server, 3)
    client.close()
    ends = client.replies()
    assert sorted(place for place, _ in ends) == [0, 1, 2]
    assert {(reply.payload, reply.outcome) for _, reply in ends} == {(None, "fate unknown")}
    if graph.abilities.sees_callers:
        for payload, caller, _ in requests:
            wait_for(lambda c=caller: not server.present(c))
            assert not server.reply(caller, echo(payload, graph.ros1))
    assert client.replies() == ends
    with pytest.raises(RosplcError, match="ROS009"):
        client.call(graph.string("closed"))


@over(lambda harness: harness.reaches_out)
def test_a_caller_that_dies(graph: Harness) -> None:
    """Where the middleware tells, its request is known to have nobody who waits; the others are served."""
    server = graph.node("server").serve("/cell/add", ADD, "keep")
    node = graph.process("client")
    client = node.client("/cell/add", ADD)
    wait_for(client.ready)
    client.call(graph.string("open"))
    ((payload, caller, _),) = asked(server)
    assert server.present(caller)
    node.kill()
    if graph.abilities.sees_callers:
        wait_for(lambda: not server.present(caller))
        assert not server.reply(caller, echo(payload, graph.ros1))
    else:
        assert server.present(caller)
    other = graph.node("other").client("/cell/add", ADD)
    wait_for(other.ready)
    place = other.call(graph.string("next"))
    payload, caller, _ = asked(server, 2)[1]
    assert server.reply(caller, echo(payload, graph.ros1))
    assert text_of(graph, wait_for(lambda: dict(other.replies()).get(place))) == "next"


def test_a_call_that_is_refused(graph: Harness) -> None:
    """It is answered no more; the caller learns of it where the middleware can tell."""
    server, client = connect(graph, "keep")
    refused = client.call(graph.string("refused"))
    ((payload, caller, _),) = asked(server)
    assert server.refuse(caller, "not now")
    assert not server.refuse(caller, "not now")
    assert not server.reply(caller, echo(payload, graph.ros1))
    place = client.call(graph.string("next"))
    payload, caller, _ = asked(server, 2)[1]
    assert server.reply(caller, echo(payload, graph.ros1))
    wait_for(lambda: place in dict(client.replies()))
    if graph.abilities.refuses_with_words:
        assert "not now" in wait_for(lambda: dict(client.replies()).get(refused)).text


def test_large_messages_arrive_whole(graph: Harness) -> None:
    """Four megabytes each way, more than any datagram or socket buffer holds."""
    _, client = connect(graph)
    text = "".join(chr(97 + number % 26) for number in range(1 << 22))
    assert answered(graph, client, text) == text


def test_messages_without_fields(graph: Harness) -> None:
    """An empty request and response are one byte in ROS 2, none in ROS 1."""
    server = graph.node("server").serve("/cell/reset", EMPTY, "keep")
    client = graph.node("client").client("/cell/reset", EMPTY)
    wait_for(client.ready)
    nothing = b"" if graph.ros1 else b"\0\1\0\0\0"
    client.call(nothing)
    ((payload, caller, _),) = asked(server)
    assert payload[: 4 if graph.ros1 else 5] == nothing
    assert server.reply(caller, nothing)
    ((_, reply),) = wait_for(client.replies)
    assert reply.payload[:5] == nothing


@over(lambda harness: harness.distros[0] != "noetic")
def test_payload_without_header_is_refused(graph: Harness) -> None:
    """Bytes that are no message are sent neither way, and what they were for can still be answered."""
    server, client = connect(graph, "keep")
    for payload in (b"", b"\0\1", b"\0\7\0\0\2\0\0\0a\0", b"abcdefgh"):
        with pytest.raises(RosplcError, match=r"/cell/add.*ROS008"):
            client.call(payload)
    place = client.call(graph.string("good"))
    ((payload, caller, _),) = asked(server)
    with pytest.raises(RosplcError, match=r"/cell/add.*ROS008"):
        server.reply(caller, b"abcdefgh")
    assert server.reply(caller, echo(payload, graph.ros1))
    assert text_of(graph, wait_for(lambda: dict(client.replies()).get(place))) == "good"
    assert [which for which, _ in client.replies()] == [place]


# memory carries nothing that another process has made; the others have tests of their own.
@over(lambda harness: harness.backend in ("dds", "zenoh"))
def test_what_no_client_sends_is_refused(graph: Harness, caplog: pytest.LogCaptureFixture) -> None:
    """Hostile bytes are counted, reach nobody, and end no thread: the next call is answered."""
    server = graph.node("server").serve("/cell/add", ADD)
    refused = graph.bother("/cell/add", ADD)
    client = graph.node("client").client("/cell/add", ADD)
    wait_for(client.ready)
    assert answered(graph, client, "good") == "good"
    wait_for(lambda: server.status().rejected >= refused)
    assert len(server.requests()) == 1
    assert [record for record in caplog.records if record.levelname == "ERROR"] == []


def test_a_receiver_that_fails(graph: Harness) -> None:
    """An exception of a receiver is counted, and the next request arrives."""
    server, client = connect(graph, "fail")
    client.call_all([graph.string("one"), graph.string("two")])
    assert len(asked(server, 2)) == 2
    wait_for(lambda: server.status().failed == 2)


def test_ends_may_close_themselves(graph: Harness) -> None:
    """A server closes while it receives a request, a client while it receives a reply."""
    server, client = connect(graph, "close")
    client.call(graph.string("last"))
    asked(server)
    ((_, reply),) = wait_for(client.replies)
    assert (reply.payload, reply.outcome) == (None, "fate unknown")
    _, client = connect(graph, service="/cell/next")
    client.call_and_close(graph.string("last"))
    ((_, reply),) = wait_for(client.replies)
    assert text_of(graph, reply) == "last"
    with pytest.raises(RosplcError, match="ROS009"):
        client.call(graph.string("closed"))


def test_closed_ends_say_so(graph: Harness) -> None:
    """Whatever is closed refuses further use, and closing twice is harmless."""
    node = graph.node("node")
    server, client = node.serve("/cell/add", ADD), node.client("/cell/add", ADD)
    for end in (server, client):
        end.close()
        end.close()
        assert (end.status().code, end.status().matched) == ("ROS009", 0)
    with pytest.raises(RosplcError, match="ROS009"):
        server.reply(bytes(16), graph.string(""))
    assert not server.present(bytes(16))
    assert not server.refuse(bytes(16), "")
    node.close()
    for open_end in (node.serve, node.client):
        with pytest.raises(RosplcError, match="ROS009"):
            open_end("/cell/add", ADD)


def test_a_node_may_call_itself(graph: Harness) -> None:
    """Server and client of one node find each other, beside a topic of the same name."""
    node = graph.node("node")
    server, client = node.serve("/cell/add", ADD), node.client("/cell/add", ADD)
    inbox, outbox = node.subscribe("/cell/add", STRING), node.advertise("/cell/add", STRING)
    wait_for(lambda: client.ready() and inbox.matched() and outbox.matched())
    assert answered(graph, client, "self") == "self"
    assert outbox.write(graph.string("topic"))
    wait_for(inbox.count)
    assert len(server.requests()) == 1


def test_names_are_resolved(graph: Harness) -> None:
    """Relative and private names are expanded, then remapped, as those of topics are."""
    node = graph.node("cell", namespace="/robot1", remap={"add": "/other/add"})
    assert node.serve("add", ADD).name() == "/other/add"
    assert node.client("~/add", ADD).name() == "/robot1/cell/add"
    for name in ("/", "/two words", "/a//b"):
        with pytest.raises(RosplcError, match="ROS005"):
            node.serve(name, ADD)
    with pytest.raises(RosplcError, match="TYP001"):
        node.client("/a", "diagnostic_msgs/srv/Nothing")


@over(lambda harness: harness.distros[0] != "noetic")  # where a second server replaces the first
def test_two_servers_are_reported(graph: Harness) -> None:
    """A second server of a name is a doubt on both sides; the first answer counts."""
    one, client = connect(graph)
    two = graph.node("another").serve("/cell/add", ADD, "echo")
    for end in (one, two, client):
        wait_for(lambda e=end: e.status().code == "ROS022")
    wait_for(lambda: "/another" in client.status().reason)
    assert answered(graph, client, "both") == "both"
    two.close()
    for end in (one, client):
        wait_for(lambda e=end: e.status().code == "")


@over(lambda harness: harness.abilities.tells_definitions)
def test_another_type_is_not_called(graph: Harness) -> None:
    """A server of the same name with another type is no server, and is reported."""
    graph.node("server").serve("/cell/add", EMPTY)
    client = graph.node("client").client("/cell/add", ADD)
    wait_for(lambda: client.status().code == "ROS003")
    assert not client.ready()


@over(lambda harness: harness.abilities.many_nodes)
def test_closing_leaves_nothing_behind(graph: Harness) -> None:
    """Threads and file descriptors are given back."""

    def cycle() -> tuple[int, int]:
        one, other = graph.node("server"), graph.node("client")
        server, client = one.serve("/cell/add", ADD, "keep"), other.client("/cell/add", ADD)
        wait_for(client.ready)
        client.call(graph.string("open"))
        asked(server)
        one.close()
        other.close()
        return one.held()

    cycle()  # the first one loads libraries
    before = cycle()
    node = graph.node("last")
    node.close()
    for _ in range(3):
        cycle()
    wait_for(lambda: all(now <= then for now, then in zip(node.held(), before, strict=True)))
