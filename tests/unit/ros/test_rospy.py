"""The parts of the ROS 1 backend that need no graph."""

from __future__ import annotations

import logging
import socket
import threading
from collections.abc import Callable
from contextlib import suppress
from types import SimpleNamespace
from typing import Any
from xmlrpc.server import SimpleXMLRPCRequestHandler, SimpleXMLRPCServer

import pytest

from rosplc.clock import SYSTEM
from rosplc.errors import RosplcError
from rosplc.model import TypeStore
from rosplc.ros import Qos, open_backend
from rosplc.ros.rospy import handshake, topics
from rosplc.ros.rospy._tcp import Outlet, Sender
from rosplc.ros.rospy.handshake import Definition, mismatch
from rosplc.ros.rospy.master import Master, read_address
from rosplc.ros.rospy.services import RospyClient, _Link
from rosplc.ros.rospy.topics import Connections, Incoming, Outgoing, RospyPublisher, RospySubscription
from rosplc_bench.process import free_port
from tests.lib.clock import SteppedClock
from tests.lib.waiting import wait_for

NOETIC = TypeStore.bundled("noetic")
STRING = "std_msgs/msg/String"
DEFINITION = Definition(STRING, "0", "string data\n")


def nowhere() -> dict[str, str]:
    """Return an environment whose master does not run."""
    return {"ROS_MASTER_URI": f"http://127.0.0.1:{free_port()}", "ROS_IP": "127.0.0.1"}


# -- the environment


@pytest.mark.parametrize(
    ("environment", "host", "bind"),
    [
        ({"ROS_IP": "127.0.0.1"}, "127.0.0.1", "127.0.0.1"),
        ({"ROS_IP": "192.168.1.10"}, "192.168.1.10", ""),
        ({"ROS_HOSTNAME": "localhost"}, "localhost", "127.0.0.1"),
        ({"ROS_HOSTNAME": "cell1.local", "ROS_IP": "127.0.0.1"}, "cell1.local", ""),
        ({}, socket.gethostname(), ""),
    ],
)
def test_address_follows_ros1(environment: dict[str, str], host: str, bind: str) -> None:
    """ROS_HOSTNAME comes before ROS_IP, a loopback address is listened at alone, the default is the host."""
    address = read_address(environment)
    assert (address.host, address.bind) == (host, bind)
    assert address.master == "http://localhost:11311"


@pytest.mark.parametrize(
    ("variable", "value"),
    [
        ("ROS_MASTER_URI", "localhost:11311"),
        ("ROS_MASTER_URI", "http://localhost"),
        ("ROS_MASTER_URI", "http://localhost:port"),
        ("ROS_IP", ""),
        ("ROS_IP", "cell1"),
        ("ROS_IP", "192.168.1.10:11311"),
        ("ROS_HOSTNAME", ""),
        ("ROS_HOSTNAME", "http://cell1"),
        ("ROS_IPV6", "on"),
    ],
)
def test_wrong_variable_is_named(variable: str, value: str) -> None:
    """A value that cannot be is refused with the variable's name."""
    with pytest.raises(RosplcError, match=rf"{variable} is .*ROS010"):
        open_backend("rospy", NOETIC, "cell", environment={variable: value})


def test_address_that_cannot_be_listened_at_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    """An address that the system refuses is an error of the environment."""

    def refuse(*_: object, **__: object) -> None:
        raise OSError(99, "Cannot assign requested address")

    environment = nowhere()
    monkeypatch.setattr("socket.create_server", refuse)
    with pytest.raises(RosplcError, match=r"cannot listen on 127\.0\.0\.1.*ROS010"):
        open_backend("rospy", NOETIC, "cell", environment=environment)


# -- types


def test_ros2_definitions_are_refused() -> None:
    """With the definitions of a ROS 2 distribution the backend does not open."""
    with pytest.raises(RosplcError, match=r"jazzy is ROS 2.*ROS001"):
        open_backend("rospy", TypeStore.bundled("jazzy"), "cell", environment=nowhere())


def test_header_carries_the_type() -> None:
    """A peer sees ROS 1's name of the type, its sum and its definition."""
    text = NOETIC.definition_text(STRING)
    assert Definition(STRING, NOETIC.md5(STRING), text).fields() == {
        "type": "std_msgs/String", "md5sum": "992ce8a1687cec8c8bd883ec73ca41d1", "message_definition": text,
    }  # fmt: skip


def test_one_topic_has_one_type_in_a_node() -> None:
    """A second type on a topic of the same node and direction is refused; the other direction is free."""
    node = open_backend("rospy", NOETIC, "cell", environment=nowhere())
    try:
        node.advertise("/a", STRING, Qos())
        with pytest.raises(RosplcError, match=r"already uses /a as std_msgs/msg/String.*ROS002"):
            node.advertise("/a", "std_msgs/msg/Int32", Qos())
        node.subscribe("/a", "std_msgs/msg/Int32", Qos(), lambda *_: None)
        assert len(node.status()) == 2
    finally:
        node.close()


@pytest.mark.parametrize(
    ("theirs", "code"),
    [
        (("a/msg/B", "1"), None),
        (("*", "*"), None),
        (("a/msg/B", "*"), None),
        (("*", "2"), "ROS003"),
        (("a/msg/B", "2"), "ROS003"),
        (("a/msg/C", "1"), "ROS003"),
    ],
)
def test_types_are_compared_by_name_and_sum(theirs: tuple[str, str], code: str | None) -> None:
    """A star stands for anything; a difference is told with both sides."""
    found = mismatch("/peer", "publishes", "/t", theirs, ("a/msg/B", "1"))
    assert (found and found[0]) == code
    if found and theirs[1] == "2":
        assert "md5 2, locally 1" in found[1]


# -- bytes on a connection


def read(data: bytes, *, close: bool = True) -> dict[str, str]:
    here, there = socket.socketpair()
    with here, there:
        there.sendall(data)
        if close:
            there.shutdown(socket.SHUT_WR)
        return handshake.read_header(here, 0.2)


def test_header_is_read_to_its_end_and_no_further() -> None:
    """What follows the header stays in the connection."""
    here, there = socket.socketpair()
    with here, there:
        there.sendall(handshake.encode_header({"topic": "/a", "note": "x=y"}))
        there.sendall(b"behind")
        assert handshake.read_header(here, 5.0) == {"topic": "/a", "note": "x=y"}
        assert here.recv(100) == b"behind"


@pytest.mark.parametrize(
    "data",
    [
        b"",
        b"\1\0",
        b"\xff\xff\xff\xff",
        b"\4\0\0\0abcd",
        b"\5\0\0\0\0\0\0\0x",
        b"\6\0\0\0\2\0\0\0\xff=",
        b"\x08\0\0\0",
    ],
    ids=repr,
)
def test_no_header_is_an_error(data: bytes) -> None:
    """Nonsense, endless lengths and early ends are one kind of error."""
    with pytest.raises(handshake.HandshakeError):
        read(data)


def test_header_that_does_not_come_is_not_waited_for() -> None:
    """A connection that says nothing is given up."""
    with pytest.raises(handshake.HandshakeError, match="in time"):
        read(b"\x10\0\0\0", close=False)


def test_header_is_given_up_by_the_injected_clock() -> None:
    """Once the clock has passed the time allowed, no more of a header is waited for."""
    clock = SteppedClock()
    here, there = socket.socketpair()
    with here, there:
        monotonic_ns = clock.monotonic_ns
        clock.monotonic_ns = lambda: clock.advance(4.0) and monotonic_ns()  # type: ignore[method-assign]
        there.sendall(b"\x10\0\0\0")
        with pytest.raises(handshake.HandshakeError, match="in time"):
            handshake.read_header(here, 5.0, clock)


def node(**more: Any) -> Any:
    """Return what stands for the backend."""
    members = {"node": "/node", "clock": SYSTEM, "turn": threading.RLock(), "wake": lambda: None}
    found = {"diagnose": lambda _: ("", ""), "forget": lambda _: None, "usable": lambda: None}
    return SimpleNamespace(**{**members, **found, **more})


def test_messages_beyond_the_depth_give_way_and_are_counted() -> None:
    """Of messages that arrive together the newest ``depth`` are handed over, in order."""
    topic, got = Incoming(node(), "/t", DEFINITION), []
    subscription = RospySubscription(lambda payload, _: got.append(payload), topic, Qos(depth=3))
    topic.add(subscription)
    topic.deliver([bytes([number]) for number in range(10)])
    assert got == [b"\7", b"\x08", b"\x09"]
    assert (subscription.status().received, subscription.status().dropped) == (3, 7)


def test_messages_go_into_the_sink_of_an_only_subscription(monkeypatch: pytest.MonkeyPatch) -> None:
    """A sink takes what it can; what it cannot, and what two subscriptions share, is delivered."""
    inbound, outbound = Connections("receive"), Connections("send")
    ours = node(inbound=inbound, outbound=outbound, connecting=threading.BoundedSemaphore(1))
    outgoing, incoming, got = Outgoing(ours, "/t", DEFINITION), Incoming(ours, "/t", DEFINITION), []
    publisher = RospyPublisher(outgoing, Qos(depth=10))
    outgoing.add(publisher)
    subscriptions = [
        RospySubscription(lambda payload, _, n=number: got.append((n, payload)), incoming, Qos(depth=10))
        for number in (1, 2)
    ]
    incoming.add(subscriptions[0])
    with socket.create_server(("127.0.0.1", 0)) as server:
        monkeypatch.setattr(topics, "request", lambda *_: server.getsockname())
        incoming.publishers = ("http://localhost:1",)
        incoming.update()
        sock, _ = server.accept()
        assert outgoing.accept(sock, handshake.read_header(sock, 5.0)) == ""
    wait_for(incoming.matched)
    sink = Outlet(Sender(outbound.loop), False)  # it has no subscribers: it takes everything
    assert subscriptions[0].divert(sink)
    assert publisher.write(b"1")
    wait_for(lambda: got == [(1, b"1")])
    sink.open(0)
    publisher.write(b"2")
    wait_for(lambda: sink.messages == 1)
    incoming.add(subscriptions[1])
    publisher.write(b"3")
    wait_for(lambda: got[1:] == [(1, b"3"), (2, b"3")])
    incoming.remove(subscriptions[1])
    publisher.write(b"4")
    wait_for(lambda: sink.messages == 2)
    assert (subscriptions[0].status().received, subscriptions[1].status().received) == (4, 1)
    assert (publisher.status().messages, publisher.status().dropped) == (4, 0)
    publisher.open_sink(0)
    for ending in (*outgoing.close(), *incoming.close()):
        ending.join()
        ending.end()
    assert (incoming.matched(), outgoing.matched()) == (0, 0)
    for connections in (inbound, outbound):
        connections.close()


def without_threads(name: str) -> Callable[[], None]:
    """Let threads of a name not start, as where a container allows no more; return what lets them again."""
    start, patch = threading.Thread.start, pytest.MonkeyPatch()

    def refuse(thread: threading.Thread) -> None:
        if thread.name == name:
            raise RuntimeError("can't start new thread")
        start(thread)

    patch.setattr(threading.Thread, "start", refuse)
    return patch.undo


def test_without_a_thread_a_caller_is_turned_away() -> None:
    """The node goes on listening, and serves the next one."""
    node: Any = open_backend("rospy", NOETIC, "cell", environment=nowhere())
    place = ("127.0.0.1", node._servers.data.port)
    try:
        for threads in (False, True):
            undo = (lambda: None) if threads else without_threads("rosplc-serve")
            try:
                with socket.create_connection(place, 10) as caller:
                    caller.sendall(handshake.encode_header({"topic": "/a", "md5sum": "*", "callerid": "/c"}))
                    if threads:
                        assert "not published" in handshake.read_header(caller, 10)["error"]
                    else:
                        with suppress(ConnectionResetError):
                            assert caller.recv(1) == b""
            finally:
                undo()
    finally:
        node.close()


def test_without_a_thread_a_publisher_is_connected_to_later(monkeypatch: pytest.MonkeyPatch) -> None:
    """The connection counts as one that failed, and is made again after the usual pause."""
    clock = SteppedClock()
    ours = node(clock=clock, connecting=threading.BoundedSemaphore(1))
    incoming = Incoming(ours, "/t", DEFINITION)
    incoming.publishers = ("http://localhost:1",)
    asked = threading.Event()
    monkeypatch.setattr(topics, "request", lambda *_: asked.set() or ("127.0.0.1", free_port()))
    undo = without_threads("rosplc-/t")
    try:
        incoming.update()
    finally:
        undo()
    assert [link.ended for link in incoming.links()] == [True]
    clock.advance(2.0)
    incoming.update()
    assert asked.wait(10)
    for link in incoming.close():
        link.join()


@pytest.mark.parametrize("what", ["close", "subscribe"])
def test_a_callback_may_open_and_close_while_another_thread_opens(what: str) -> None:
    """Neither waits for the other: the callback may close or open a subscription itself."""
    node: Any = open_backend("rospy", NOETIC, "cell", environment=nowhere())
    called, opening = threading.Event(), threading.Event()
    resolve = node._resolve

    def callback(*_: object) -> None:
        called.set()
        assert opening.wait(10)
        own.close() if what == "close" else node.subscribe("/c", STRING, Qos(), callback)

    def resolved(*names: str) -> tuple[str, str]:
        if names[0] == "/b":  # the node's lock is held
            opening.set()
        found: tuple[str, str] = resolve(*names)
        return found

    def open_another() -> None:
        assert called.wait(10)
        node.subscribe("/b", STRING, Qos(), callback)

    own = node.subscribe("/a", STRING, Qos(), callback)
    node._resolve = resolved
    incoming = node.having("in")["/a"]
    threads = [threading.Thread(target=incoming.deliver, args=([b""],), daemon=True)]
    threads.append(threading.Thread(target=open_another, daemon=True))
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join(10)
    assert not any(thread.is_alive() for thread in threads), "they wait for each other"
    there = ["/b"] if what == "close" else ["/a", "/b", "/c"]
    assert sorted(one.topic for one in node.status()) == there
    node.close()


# -- services


def service_client(monkeypatch: pytest.MonkeyPatch, host: str) -> RospyClient:
    """Return a client whose server has registered itself at a host."""
    node = SimpleNamespace(
        clock=SYSTEM,
        node="/n",
        logger=logging.getLogger("rosplc.ros.rospy"),
        connecting=threading.BoundedSemaphore(1),
        wake=lambda: None,
        usable=lambda: None,
        service_md5=lambda _: "0",
        servers=lambda _: frozenset({"/server"}),
    )
    monkeypatch.setattr(RospyClient, "_lookup", lambda _: (host, 80))
    return RospyClient(node, "/s", "std_srvs/srv/Trigger", Qos())


def test_a_server_at_a_host_that_cannot_be_one(monkeypatch: pytest.MonkeyPatch) -> None:
    """It is not ready; a call that is made anyway was certainly not executed."""
    client = service_client(monkeypatch, "a..b")
    client._look()
    assert "cannot be called" in client.problem[1]
    assert not client.ready
    assert client._exchange(_Link(), b"").outcome == "not executed"


def test_without_a_thread_a_service_is_not_called(monkeypatch: pytest.MonkeyPatch) -> None:
    """Its server is looked for again once there are threads."""
    client = service_client(monkeypatch, "a..b")

    def none(_: threading.Thread) -> None:
        raise RuntimeError("can't start new thread")

    with monkeypatch.context() as patch:
        patch.setattr(threading.Thread, "start", none)
        reply = client._send(1, b"")
        client.update()
    assert reply is not None
    assert (reply.outcome, client._links) == ("not executed", {})
    assert not client.problem[1]
    client.update()
    wait_for(lambda: client.problem[1])


# -- the master


def test_large_graphs_are_read_call_after_call() -> None:
    """An answer that Python's servers would compress is read, and so is the next on the same connection."""

    class Handler(SimpleXMLRPCRequestHandler):
        protocol_version = "HTTP/1.1"  # as rosmaster's: the connection is kept

    rows = [[f"/topic{number}", ["/node"]] for number in range(500)]
    with SimpleXMLRPCServer(("127.0.0.1", 0), Handler, logRequests=False) as server:
        server.register_function(lambda _caller: (1, "", [rows, [], []]), "getSystemState")
        server.register_function(lambda _caller: (1, "", []), "getTopicTypes")
        threading.Thread(target=server.serve_forever, daemon=True).start()
        master = Master(f"http://127.0.0.1:{server.server_address[1]}", "/caller")
        try:
            for _ in range(3):
                assert len(master.state().publishers) == 500
        finally:
            master.close()
            server.shutdown()
