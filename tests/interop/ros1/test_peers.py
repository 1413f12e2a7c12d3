"""The ROS 1 backend against programs of rospy and roscpp, in processes of their own."""

from __future__ import annotations

import hashlib
import itertools
import json
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from rosbags.typesys import Stores, get_typestore

from rosplc.errors import RosplcError
from rosplc.model import TypeStore
from rosplc.ros import LATCHED, Backend, Qos, open_backend
from tests.interop.ros1.graph import PACKAGES, Graph, lend
from tests.lib.waiting import wait_for

pytestmark = [
    pytest.mark.needs(*PACKAGES),
    pytest.mark.timeout(120),
    pytest.mark.verifies("ros1", real="rospy, roscpp"),
]

STORE = TypeStore.bundled("noetic")
STRING = "std_msgs/msg/String"
KINDS = ("rospy", "roscpp")
DEEP = Qos(depth=1000)

# The oracle for values: another implementation of ROS 1's serialization, by another project.
ORACLE = get_typestore(Stores.ROS1_NOETIC)

PART = "cell_msgs/msg/Part"
PART_FILE = """# A part on its way through the cell.
uint8 OK=0
uint8 SCRAP=1
Header header
string serial
geometry_msgs/Pose place   # where it lies
float32[] weights
uint8 state
"""
PART_STORE = STORE.with_definition(PART, PART_FILE)


def part_defines() -> tuple[str, str]:
    """Return what the roscpp peer has to know of the custom type."""
    return (
        f'PART_MD5="{PART_STORE.md5(PART)}"',
        f"PART_TEXT={json.dumps(PART_STORE.definition_text(PART))}",
    )


@pytest.fixture
def ros1() -> Iterator[Graph]:
    """A master of the test's own."""
    with lend() as graph:
        yield graph


OpenNode = Callable[..., Backend]


@pytest.fixture
def node(ros1: Graph) -> Iterator[OpenNode]:
    """Open nodes of the backend under test: ``node("cell")``."""
    opened: list[Backend] = []

    def open_node(name: str, store: TypeStore = STORE, namespace: str = "/", **more: Any) -> Backend:
        more.setdefault("environment", ros1.environment)
        opened.append(open_backend("rospy", store, name, namespace, **more))
        return opened[-1]

    yield open_node
    for backend in opened:
        backend.close()


class Inbox(list):  # type: ignore[type-arg]
    """Payloads received; also a callback."""

    def __call__(self, payload: bytes, stamp_ns: int) -> None:
        self.append(payload)


def string(text: str) -> bytes:
    data = text.encode()
    return len(data).to_bytes(4, "little") + data


def values(kind: str, count: int) -> list[bytes]:
    """Return messages of a type as the oracle serializes them."""
    import numpy as np

    types = ORACLE.types
    vector, header = types["geometry_msgs/msg/Vector3"], types["std_msgs/msg/Header"]
    stamp = types["builtin_interfaces/msg/Time"]
    out = []
    for i in range(count):
        if kind == "geometry_msgs/msg/Twist":
            message: Any = types[kind](vector(i + 0.5, -i / 3, 1e-300), vector(0.1, 1e300, i * 0.25))
        else:
            n = i % 8
            message = types["sensor_msgs/msg/JointState"](
                header(seq=i, stamp=stamp(i, 999_999_999), frame_id="base"),
                [f"joint{k}" for k in range(n)],
                np.array([k + i / 4 for k in range(n)]),
                np.array([2.5] * (i % 2)),
                np.array([]),
            )
        out.append(bytes(ORACLE.serialize_ros1(message, kind)))
    return out


def without_seq(kind: str, payloads: list[bytes]) -> list[bytes]:
    """Drop Header.seq, which every ROS 1 publisher counts by itself."""
    return payloads if kind == "geometry_msgs/msg/Twist" else [payload[4:] for payload in payloads]


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("type_name", ["geometry_msgs/msg/Twist", "sensor_msgs/msg/JointState"])
def test_values_cross_both_ways(ros1: Graph, node: OpenNode, kind: str, type_name: str) -> None:
    """What one side sends, the other has, value by value and in order, through the peer's own classes."""
    peer = ros1.peer(kind, "peer")
    cell, inbox = node("cell"), Inbox()
    outbox = cell.advertise("/down", type_name, DEEP)
    up = cell.subscribe("/up", type_name, DEEP, inbox)
    heard, said = peer.subscribe("/down", type_name), peer.advertise("/up", type_name)
    # Its own count as well: a publisher answers its subscriber before it sends to it.
    wait_for(lambda: outbox.matched and up.matched and peer.matched("/up"))
    sent = values(type_name, 50)
    for payload in sent:
        assert outbox.write(payload)
        said.write(payload)
    wait_for(lambda: len(inbox) == 50 and len(heard.payloads()) == 50)
    assert heard.payloads() == sent
    assert without_seq(type_name, inbox) == without_seq(type_name, sent)
    assert (outbox.status().sent, up.status().received) == (50, 50)
    assert up.status().reason == outbox.status().reason == ""


@pytest.mark.parametrize("kind", KINDS)
def test_latched_messages_cross_both_ways(ros1: Graph, node: OpenNode, kind: str) -> None:
    """A subscriber that comes late gets the last message of a latched publisher, on either side."""
    cell = node("cell")
    outbox = cell.advertise("/map", STRING, LATCHED)
    for text in "abc":
        outbox.write(string(text))
    peer = ros1.peer(kind, "peer")
    heard = peer.subscribe("/map", STRING)
    wait_for(heard.payloads)
    assert heard.payloads() == [string("c")]
    said = peer.advertise("/plan", STRING, LATCHED)
    for text in "xyz":
        said.write(string(text))
    inbox = Inbox()
    cell.subscribe("/plan", STRING, DEEP, inbox)
    wait_for(lambda: inbox)
    assert inbox == [string("z")]
    wait_for(lambda: any(e.qos.durability == "transient_local" for e in cell.graph().endpoints))


@pytest.mark.parametrize("kind", KINDS)
def test_peers_of_another_type_are_named(ros1: Graph, node: OpenNode, kind: str) -> None:
    """A peer with another type is named on both sides, with both types; nothing of it is delivered."""
    peer = ros1.peer(kind, "odd")
    said, _ = peer.advertise("/up", "std_msgs/Int32"), peer.subscribe("/down", "std_msgs/Int32")
    cell, inbox = node("cell"), Inbox()
    up = cell.subscribe("/up", STRING, DEEP, inbox)
    down = cell.advertise("/down", STRING, DEEP)
    wait_for(lambda: (up.status().code, down.status().code) == ("ROS003", "ROS003"))
    assert (
        up.status().reason == f"node /odd publishes /up as std_msgs/msg/Int32, but the local type is {STRING}"
    )
    words = f"node /odd subscribes to /down as std_msgs/msg/Int32, but the local type is {STRING}"
    assert down.status().reason == words
    said.write(bytes(4))
    assert down.write(string("x"))
    assert (up.matched, down.matched, inbox) == (0, 0, [])
    peer.close()
    wait_for(lambda: (up.status().reason, up.status().code) == ("no node publishes /up", ""))
    wait_for(lambda: (down.status().reason, down.status().code) == ("no node subscribes to /down", ""))


def test_another_definition_is_named_with_both_sums(ros1: Graph, node: OpenNode) -> None:
    """A peer whose type has the same name and another MD5 sum is named with both sums, both ways."""
    peer = ros1.peer("roscpp", "old", *part_defines())
    peer.advertise("/up", PART)
    peer.subscribe("/down", PART)
    newer = STORE.with_definition(PART, PART_FILE + "uint32 batch\n")
    cell = node("cell", newer)
    up, down = cell.subscribe("/up", PART, DEEP, Inbox()), cell.advertise("/down", PART, DEEP)
    wait_for(lambda: (up.status().code, down.status().code) == ("ROS003", "ROS003"))
    sums = f"with another definition (md5 {PART_STORE.md5(PART)}, locally {newer.md5(PART)})"
    assert up.status().reason == f"node /old publishes /up as {PART} {sums}"
    assert down.status().reason == f"node /old subscribes to /down as {PART} {sums}"


def test_custom_type_crosses_both_ways(ros1: Graph, node: OpenNode, tmp_path: Path) -> None:
    """A type that only a .msg file defines crosses to and from a roscpp program that has it compiled in."""
    (tmp_path / "cell_msgs/msg").mkdir(parents=True)
    (tmp_path / "cell_msgs/msg/Part.msg").write_text(PART_FILE)
    store = STORE.with_paths([tmp_path])
    # Computed here by hand, as genmsg does: constants first, complex types by their own sums.
    sums = {name: STORE.md5(name) for name in ("std_msgs/msg/Header", "geometry_msgs/msg/Pose")}
    text = (
        f"uint8 OK=0\nuint8 SCRAP=1\n{sums['std_msgs/msg/Header']} header\nstring serial\n"
        f"{sums['geometry_msgs/msg/Pose']} place\nfloat32[] weights\nuint8 state"
    )
    assert store.md5(PART) == hashlib.md5(text.encode(), usedforsecurity=False).hexdigest()
    peer = ros1.peer("roscpp", "cpp", *part_defines())
    cell, inbox = node("cell", store), Inbox()
    outbox, up = cell.advertise("/down", PART, DEEP), cell.subscribe("/up", PART, DEEP, inbox)
    heard, said = peer.subscribe("/down", PART), peer.advertise("/up", PART)
    wait_for(lambda: outbox.matched and up.matched and peer.matched("/up"))
    payload = bytes(12) + string("base") + string("S-17") + bytes(range(56)) + b"\1\0\0\0\0\0\x80\x3f" + b"\1"
    outbox.write(payload)
    said.write(payload)
    wait_for(lambda: inbox and heard.payloads())
    assert (inbox, heard.payloads()) == ([payload], [payload])


@pytest.mark.parametrize("kind", KINDS)
def test_peers_come_and_go(ros1: Graph, node: OpenNode, kind: str) -> None:
    """Peers that are killed, started again, or withdraw a topic are missed and found again."""
    cell, inbox = node("cell"), Inbox()
    outbox, up = cell.advertise("/down", STRING, DEEP), cell.subscribe("/up", STRING, DEEP, inbox)
    for life in range(2):
        peer = ros1.peer(kind, "peer")
        said, heard = peer.advertise("/up", STRING), peer.subscribe("/down", STRING)
        # A killed peer's old name is still registered: wait for this life's connections.
        wait_for(lambda p=peer: p.matched("/up") and p.matched("/down"))
        wait_for(lambda: up.matched == 1 and outbox.matched == 1)
        said.write(string(f"up {life}"))
        outbox.write(string(f"down {life}"))
        wait_for(lambda w=f"up {life}": inbox[-1:] == [string(w)])
        wait_for(lambda h=heard, w=f"down {life}": h.payloads() == [string(w)])
        if life == 0:
            peer.kill()
            wait_for(lambda: up.matched == 0 and outbox.matched == 0)
        else:
            peer.unadvertise("/up")
            wait_for(lambda: up.matched == 0)
            assert outbox.matched == 1


def test_peer_that_stands_still_costs_messages_and_no_time(ros1: Graph, node: OpenNode) -> None:
    """While a subscriber's process is stopped, writes return, and what gives way is counted."""
    peer = ros1.peer("roscpp", "peer")
    outbox = node("cell").advertise("/down", STRING, Qos(depth=10))
    # Deep enough that roscpp drops nothing itself when it goes on.
    heard = peer.subscribe("/down", STRING, Qos(depth=100_000))
    wait_for(lambda: outbox.matched)
    peer.stop()
    text = "x" * 4000
    taken = sum(outbox.write(string(f"{number:06}{text}")) for number in range(5000))
    assert taken < 5000
    status = outbox.status()
    assert (status.sent, status.dropped) == (taken, 5000 - taken)
    peer.resume()
    wait_for(lambda: len(heard.payloads()) == taken)
    numbers = [int(payload[4:10]) for payload in heard.payloads()]
    assert numbers == sorted(set(numbers))
    assert numbers[-10:] == list(range(4990, 5000))


def test_namespace_and_remapping_reach_the_graph(ros1: Graph, node: OpenNode) -> None:
    """A node in a namespace with remapped topics meets peers under the names that result."""
    peer = ros1.peer("rospy", "peer")
    cell = node("cell", namespace="/robot1", remap={"cmd_vel": "/base/cmd_vel"})
    inbox = Inbox()
    sub = cell.subscribe("cmd_vel", STRING, DEEP, inbox)
    pub = cell.advertise("~/state", STRING, DEEP)
    said, heard = peer.advertise("/base/cmd_vel", STRING), peer.subscribe("/robot1/cell/state", STRING)
    wait_for(lambda: sub.matched and pub.matched and peer.matched("/base/cmd_vel"))
    said.write(string("go"))
    pub.write(string("gone"))
    wait_for(lambda: inbox and heard.payloads())
    assert "/robot1/cell" in ros1.run("rosnode", "list").split()
    assert "/robot1/cell" in ros1.run("rostopic", "info", "/base/cmd_vel")


def test_starts_without_a_master(node: OpenNode, ros1: Graph, caplog: pytest.LogCaptureFixture) -> None:
    """A node that starts first says that no master answers, and connects once there is one."""
    ros1.kill_master()
    cell, inbox = node("cell"), Inbox()
    outbox, up = cell.advertise("/down", STRING, LATCHED), cell.subscribe("/up", STRING, DEEP, inbox)
    wait_for(lambda: up.status().code == outbox.status().code == "ROS014")
    address = ros1.environment["ROS_MASTER_URI"]
    assert up.status().reason == f"the ROS master at {address} does not answer (Connection refused)"
    assert outbox.write(string("early"))
    ros1.start_master()
    peer = ros1.peer("rospy", "peer")
    heard = peer.subscribe("/down", STRING)
    wait_for(heard.payloads)
    assert heard.payloads() == [string("early")]
    wait_for(lambda: outbox.status().code == "")
    assert caplog.text.count("does not answer") == 1


@pytest.mark.parametrize("kind", KINDS)
def test_master_is_killed_amid_a_stream(ros1: Graph, node: OpenNode, kind: str) -> None:
    """The stream goes on without a master, and the next master knows the node and all its topics again."""
    peer = ros1.peer(kind, "peer")
    cell, inbox = node("cell"), Inbox()
    outbox, up = cell.advertise("/down", STRING, DEEP), cell.subscribe("/up", STRING, DEEP, inbox)
    heard, said = peer.subscribe("/down", STRING), peer.advertise("/up", STRING)
    wait_for(lambda: outbox.matched and up.matched and peer.matched("/up"))
    numbers = itertools.count()
    sent = []

    def stream(seconds: float) -> None:
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            sent.append(string(str(next(numbers))))
            outbox.write(sent[-1])
            said.write(sent[-1])
            time.sleep(0.005)

    stream(0.2)
    ros1.kill_master()
    stream(0.5)
    wait_for(lambda: up.status().code == "ROS014")
    assert (up.matched, outbox.matched) == (1, 1)
    ros1.start_master()
    stream(0.5)
    wait_for(lambda: up.status().code == "")
    wait_for(lambda: len(inbox) == len(sent) and len(heard.payloads()) == len(sent))
    assert list(inbox) == heard.payloads() == sent
    newcomer = ros1.peer(kind, "newcomer")
    late = newcomer.subscribe("/down", STRING)
    other = newcomer.advertise("/up", STRING)
    wait_for(lambda: newcomer.matched("/down") and newcomer.matched("/up"))
    wait_for(lambda: up.matched == 2 and outbox.matched == 2)
    other.write(string("from the newcomer"))
    outbox.write(string("to both"))
    wait_for(lambda: string("from the newcomer") in inbox)
    wait_for(lambda: late.payloads() == [string("to both")] and heard.payloads()[-1] == string("to both"))


def test_master_that_stands_still_stops_nothing(ros1: Graph, node: OpenNode) -> None:
    """While the master's process hangs, calls return, messages flow, and closing ends."""
    peer = ros1.peer("rospy", "peer")
    cell = node("cell")
    outbox = cell.advertise("/down", STRING, DEEP)
    heard = peer.subscribe("/down", STRING)
    wait_for(lambda: outbox.matched)
    ros1.freeze_master(True)
    other = cell.advertise("/other", STRING, DEEP)
    outbox.write(string("on"))
    wait_for(heard.payloads)
    wait_for(lambda: other.status().code == "ROS014")
    cell.graph()
    cell.close()
    ros1.freeze_master(False)


def test_older_node_of_a_name_gives_way_and_says_so(ros1: Graph, node: OpenNode) -> None:
    """Of two nodes with one name the older leaves, as ROS 1 has it; its status and its writes tell why."""
    old, new = node("cell"), None
    outbox = old.advertise("/down", STRING, DEEP)
    wait_for(lambda: "/cell" in ros1.run("rosnode", "list"))
    new = node("cell")
    newer = new.advertise("/down", STRING, DEEP)
    wait_for(lambda: outbox.status().code == "ROS015")
    assert outbox.status().reason == "another node named /cell has started, and ROS 1 keeps the newer node"
    for use in (lambda: outbox.write(string("x")), lambda: old.advertise("/more", STRING, DEEP)):
        with pytest.raises(RosplcError, match="another node named /cell has started"):
            use()
    peer = ros1.peer("rospy", "peer")
    heard = peer.subscribe("/down", STRING)
    wait_for(lambda: newer.matched)
    newer.write(string("from the newer"))
    wait_for(heard.payloads)
    old.close()
    assert "/cell" in ros1.run("rosnode", "list")
    assert newer.status().code == ""


def test_bytes_that_are_no_header_trouble_nobody(ros1: Graph, node: OpenNode) -> None:
    """Connections that send nonsense, endless lengths or nothing do not keep subscribers from coming."""
    import socket
    import xmlrpc.client

    cell = node("cell")
    outbox = cell.advertise("/down", STRING, DEEP)
    slave = xmlrpc.client.ServerProxy(cell.uri)  # type: ignore[attr-defined]
    _, _, (_, host, port) = slave.requestTopic("/test", "/down", [["TCPROS"]])  # type: ignore[misc]
    with_nothing = socket.create_connection((host, port))
    for data in (b"", b"\xff" * 4, b"\4\0\0\0\0\0\0\0", b"\5\0\0\0\1\0\0\0x", b"\x0b\0\0\0\7\0\0\0topic=/"):
        with socket.create_connection((host, port)) as sock:
            sock.sendall(data)
    for arguments in ((1, 2), ("/test", 0), ("/test", ["no"])):
        assert slave.publisherUpdate("/test", *arguments)[0] in (1, -1)  # type: ignore[index]
        assert slave.requestTopic("/test", *arguments)[0] < 1  # type: ignore[index]
    peer = ros1.peer("roscpp", "peer")
    heard = peer.subscribe("/down", STRING)
    wait_for(lambda: outbox.matched)
    outbox.write(string("x"))
    wait_for(heard.payloads)
    with_nothing.close()
    slave("close")()
