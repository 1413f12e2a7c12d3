"""The DDS backend's own parts: configuration, types, announcements, bad bytes."""

from __future__ import annotations

import logging
import struct
import subprocess
import sys
import threading
import xml.etree.ElementTree as ET
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("cyclonedds", reason="no wheel of cyclonedds for this machine")

from cyclonedds.topic import Topic
from rosbags.typesys import Stores, get_typestore

from rosplc.errors import BackendError
from rosplc.model import DISTROS, TypeStore
from rosplc.ros import EndpointStatus, Qos
from rosplc.ros._base import BaseEndpoint
from rosplc.ros.dds import _batch
from rosplc.ros.dds import backend as domain_module
from rosplc.ros.dds.backend import check_peers, domain_config, domain_id
from rosplc.ros.dds.idl import IdlTypes, dds_topic, ros_topic
from rosplc.ros.dds.peers import (
    ANNOUNCEMENT,
    ANNOUNCEMENT_TOPIC,
    NodeEntities,
    decode_announcement,
    encode_announcement,
)
from tests.interop.graphs import STRING, Graph, string
from tests.lib.waiting import wait_for

ROOT = Path(__file__).resolve().parents[3]

ROS2 = [distro for distro in DISTROS if distro != "noetic"]


def parsed(environment: dict[str, str], distro: str = "jazzy") -> ET.Element:
    """Return the domain of the first fragment, checked to be XML."""
    domain = ET.fromstring(domain_config(environment, distro).split(",<")[0]).find("Domain")
    assert domain is not None
    return domain


def test_default_range_uses_multicast() -> None:
    """Without variables discovery is what Cyclone does by itself, with more participants per machine."""
    domain = parsed({})
    assert domain.find("General") is None
    assert domain.findtext("Discovery/MaxAutoParticipantIndex") == "32"
    assert domain.find("Discovery/Peers") is None
    assert domain.findtext("Compatibility/IgnoreTypeInformation") == "1.15,1.16"


@pytest.mark.parametrize(
    ("environment", "distro"),
    [
        ({"ROS_LOCALHOST_ONLY": "1"}, "humble"),
        ({"ROS_LOCALHOST_ONLY": "1"}, "jazzy"),
        ({"ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"}, "jazzy"),
        ({"ROS_LOCALHOST_ONLY": "1", "ROS_AUTOMATIC_DISCOVERY_RANGE": "OFF"}, "jazzy"),
    ],
)
def test_localhost_range_uses_unicast(environment: dict[str, str], distro: str) -> None:
    """On localhost discovery needs no multicast, and hears what is sent to 127.0.0.1."""
    domain = parsed(environment, distro)
    assert domain.findtext("General/AllowMulticast") == "false"
    assert [i.attrib for i in domain.findall("General/Interfaces/*")] == [{"address": "127.0.0.1"}]
    assert [p.get("address") for p in domain.findall("Discovery/Peers/Peer")] == ["localhost"]


def test_static_peers_are_asked() -> None:
    """``ROS_STATIC_PEERS`` adds peers, and an interface to reach them by."""
    environment = {
        "ROS_STATIC_PEERS": "10.0.0.7; robot.local;;",
        "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST",
    }
    domain = parsed(environment)
    assert [p.get("address") for p in domain.findall("Discovery/Peers/Peer")] == [
        "localhost",
        "10.0.0.7",
        "robot.local",
    ]
    assert [i.attrib for i in domain.findall("General/Interfaces/*")] == [
        {"autodetermine": "true"},
        {"address": "127.0.0.1"},
    ]


def test_peer_addresses_are_quoted() -> None:
    """What is in the variable cannot leave its attribute."""
    domain = parsed({"ROS_STATIC_PEERS": '"/><Evil a="&'})
    assert [p.get("address") for p in domain.findall("Discovery/Peers/Peer")] == ['"/><Evil a="&']


@pytest.mark.parametrize("peer", ["::1", "256.1.1.1", "host.invalid", "10.0.0.7:http", "<>"])
def test_peers_without_an_address_are_named(peer: str) -> None:
    """The library would abort the process; the rest of the list does not hide it."""
    with pytest.raises(BackendError, match="ROS010") as refused:
        check_peers({"ROS_STATIC_PEERS": f"10.0.0.7; {peer}"}, "jazzy")
    assert peer in refused.value.what


@pytest.mark.parametrize(
    "environment",
    [
        {"ROS_STATIC_PEERS": "10.0.0.7;localhost; 10.0.0.8:7410"},
        {"ROS_STATIC_PEERS": "host.invalid", "ROS_LOCALHOST_ONLY": "1"},
        {"ROS_STATIC_PEERS": "host.invalid", "ROS_AUTOMATIC_DISCOVERY_RANGE": "OFF"},
    ],
)
def test_peers_with_addresses_and_unused_ones_are_fine(environment: dict[str, str]) -> None:
    """Only what will be looked up has to be found."""
    check_peers(environment, "jazzy")


def test_humble_knows_no_ranges() -> None:
    """Humble looks at ``ROS_LOCALHOST_ONLY`` alone."""
    assert (
        parsed({"ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST", "ROS_STATIC_PEERS": "x"}, "humble").find(
            "General"
        )
        is None
    )


def test_discovery_can_be_off() -> None:
    """With OFF a tag of the process's own keeps everybody out."""
    domain = parsed({"ROS_AUTOMATIC_DISCOVERY_RANGE": "OFF"})
    assert (domain.findtext("Discovery/Tag") or "").startswith("ros_discovery_off_")


def test_users_configuration_comes_last() -> None:
    """``CYCLONEDDS_URI`` follows ours, so that it wins, and its interfaces stand alone."""
    interfaces = "<Interfaces><NetworkInterface name='eth1'/></Interfaces>"
    uri = f"<CycloneDDS><Domain><General>{interfaces}</General></Domain></CycloneDDS>"
    config = domain_config({"CYCLONEDDS_URI": uri, "ROS_LOCALHOST_ONLY": "1"}, "jazzy")
    assert config.endswith("," + uri)
    assert config.count("NetworkInterface") == 1


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("ROS_LOCALHOST_ONLY", "yes"),
        ("ROS_AUTOMATIC_DISCOVERY_RANGE", "localhost"),
        ("CYCLONEDDS_URI", "<ä/>"),
    ],
)
def test_wrong_settings_are_named(name: str, value: str) -> None:
    """A variable with a value that ROS does not know is refused by its name."""
    with pytest.raises(BackendError, match="ROS010") as refused:
        domain_config({name: value}, "jazzy")
    assert refused.value.where == name


def test_domain_comes_from_the_environment() -> None:
    """An explicit domain wins over ``ROS_DOMAIN_ID``, which wins over 0."""
    assert (
        domain_id(5, {"ROS_DOMAIN_ID": "7"}),
        domain_id(None, {"ROS_DOMAIN_ID": "7"}),
        domain_id(None, {}),
    ) == (5, 7, 0)


def test_broken_configuration_is_explained(graph: Graph) -> None:
    """A ``CYCLONEDDS_URI`` that the library refuses gives an error that names it."""
    with pytest.raises(BackendError, match=r"cannot join domain .*ROS002.*CYCLONEDDS_URI"):
        graph.node(
            "node",
            environment={
                "CYCLONEDDS_URI": "<CycloneDDS><Domain><Nonsense>1</Nonsense></Domain></CycloneDDS>"
            },
        )
    graph.node("node").close()


def test_names_are_those_of_ros_2() -> None:
    """Topic and type names are mangled as every ROS 2 layer over DDS does it."""
    assert dds_topic("/a/b") == "rt/a/b"
    assert (ros_topic("rt/a/b"), ros_topic("rq/a/bRequest"), ros_topic("plain")) == ("/a/b", None, None)


OPEN_ALL = """
import sys
from rosplc.model import TypeStore
from rosplc.ros import EndpointStatus, Qos
from rosplc.ros._base import BaseEndpoint
from tests.interop.graphs import Graph

graph = Graph("dds", int(sys.argv[2]))
store = TypeStore.bundled(sys.argv[1])
node = graph.node("node", store)
for number, name in enumerate(store.names()):
    node.advertise(f"/t{number}", name, Qos(depth=1)).close()
graph.close()
print(number + 1)
"""


@pytest.mark.foreign
@pytest.mark.parametrize("distro", ROS2)
def test_every_bundled_type_opens(graph: Graph, distro: str) -> None:
    """Each type of each distribution makes a DDS topic, in a process that did nothing else, as a bridge's."""
    done = subprocess.run(
        [sys.executable, "-c", OPEN_ALL, distro, str(graph.domain)],
        cwd=ROOT,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    assert int(done.stdout) == len(TypeStore.bundled(distro).names())


def test_type_classes_are_made_once() -> None:
    """Asking again, by the long or the short name, gives the same class."""
    types = IdlTypes(TypeStore.bundled("jazzy"))
    assert types["geometry_msgs/msg/Twist"] is types["geometry_msgs/Twist"]


def oracle_bytes(distro: str, nodes: list[NodeEntities]) -> bytes:
    """Serialize an announcement with another project's CDR."""
    import numpy as np

    store = get_typestore(getattr(Stores, f"ROS2_{distro.upper()}"))
    t: Any = store.types
    gid, info = t["rmw_dds_common/msg/Gid"], t["rmw_dds_common/msg/NodeEntitiesInfo"]

    def g(data: bytes) -> Any:
        return gid(np.frombuffer(data.ljust(24 if distro == "humble" else 16, b"\0"), np.uint8))

    infos = [info(n.namespace, n.name, [g(x) for x in n.readers], [g(x) for x in n.writers]) for n in nodes]
    return bytes(store.serialize_cdr(t[ANNOUNCEMENT](g(b"p" * 16), infos), ANNOUNCEMENT))


NODES = [
    NodeEntities("/", "a"),
    NodeEntities("/ns", "talker", (b"r" * 16,), (b"w" * 16, b"x" * 16)),
    NodeEntities("/nested/ns", "listener1", (bytes(range(16)),)),
]


@pytest.mark.parametrize("distro", ["humble", "jazzy"])
@pytest.mark.parametrize("count", range(4))
def test_announcement_bytes(distro: str, count: int) -> None:
    """Announcements are encoded as another implementation does it, and read back."""
    nodes, types = NODES[:count], TypeStore.bundled(distro)
    data = encode_announcement(types, b"p" * 16, nodes)
    expected = oracle_bytes(distro, nodes)
    assert data == expected + bytes(-len(expected) % 4)
    assert decode_announcement(types, data) == (b"p" * 16, tuple(nodes))


def test_damaged_announcements_are_refused() -> None:
    """Every truncation, and absurd counts, are ROS008 and nothing else."""
    types = TypeStore.bundled("jazzy")
    data = encode_announcement(types, b"p" * 16, NODES)
    for length in range(len(data)):
        with pytest.raises(BackendError, match="ROS008"):
            decode_announcement(types, data[:length])
    with pytest.raises(BackendError, match="ROS008"):
        decode_announcement(types, data[:20] + struct.pack("<I", 2**32 - 1) + data[24:])


@pytest.mark.parametrize(
    "body",
    [b"", b"\xff\xff\xff\xff", b"\x09\0\0\0abcd", b"\0\0\0\x02a\0"],
    ids=["empty", "huge length", "truncated", "other byte order"],
)
def test_bytes_that_do_not_fit_are_refused(graph: Graph, body: bytes) -> None:
    """A payload that is no message of the type is refused before it is sent."""
    publisher = graph.node("node").advertise("/chatter", STRING, Qos())
    with pytest.raises(BackendError, match=r"are not a valid std_msgs/msg/String.*ROS008"):
        publisher.write(b"\0\1\0\0" + body)
    assert (publisher.status().sent, publisher.status().rejected) == (0, 1)


def test_mismatch_is_said_once_in_the_log(graph: Graph, caplog: pytest.LogCaptureFixture) -> None:
    """What keeps a peer from matching is logged, once, without anybody asking."""
    with caplog.at_level(logging.WARNING, "rosplc.ros.dds"):
        graph.node("talker").advertise("/chatter", STRING, Qos(reliability="best_effort"))
        graph.node("listener").subscribe("/chatter", STRING, Qos(), lambda *_: None)
        words = "the publisher is best_effort and the subscriber requests reliable [ROS004]"
        wait_for(lambda: caplog.text.count(words) == 2)
    assert "node /talker publishes /chatter" in caplog.text
    assert "node /listener subscribes to /chatter" in caplog.text


def test_a_status_that_is_kept_is_what_would_be_found(graph: Graph) -> None:
    """Peers that come, do not fit, and leave, messages and losses: each is in a status at once."""
    node = graph.node("node")
    ends = [
        node.subscribe("/in", STRING, Qos(lease_ns=10**9, deadline_ns=10**8), lambda *_: None),
        node.advertise("/out", STRING, Qos(deadline_ns=10**8)),
    ]

    def seen(what: Callable[[EndpointStatus], object]) -> None:
        def same() -> bool:
            # Found between two that are the same: nothing has changed meanwhile.
            before, found, after = (
                [end.status() for end in ends],
                [BaseEndpoint.status(end) for end in ends],
                [end.status() for end in ends],
            )
            assert before != after or found == after
            return before == after and any(what(status) for status in found)

        wait_for(same)

    seen(lambda status: status.reason == "no node publishes /in")
    assert [end.status() for end in ends] == [end.status() for end in ends]
    other = graph.node("other")
    talker = other.advertise("/in", STRING, Qos(lease_ns=10**9, deadline_ns=10**8))
    listener = other.subscribe("/out", STRING, Qos(), lambda *_: None)
    seen(lambda status: status.direction == "in" and status.matched == 1)
    seen(lambda status: status.direction == "out" and status.matched == 1)
    talker.write(string("a"))
    seen(lambda status: status.messages == 1)
    seen(lambda status: status.late > 1)
    misfit = other.advertise("/in", STRING, Qos(reliability="best_effort"))
    seen(lambda status: status.code == "ROS004")
    misfit.close()
    seen(lambda status: status.direction == "in" and not status.code)
    for each in (talker, listener):
        each.close()
        seen(lambda status: status.matched == 0)
    seen(lambda status: status.reason == "no node publishes /in")
    seen(lambda status: status.reason == "no node subscribes to /out")


def test_a_change_is_told_once_by_the_library(graph: Graph) -> None:
    """A peer that has come or gone is a change once; an endpoint that is no more has always changed."""
    publisher = graph.node("node").advertise("/out", STRING, Qos())
    pairs = publisher.changing
    changed = lambda: _batch.changed(pairs)  # noqa: E731
    assert not changed()
    other = graph.node("other").subscribe("/out", STRING, Qos(), lambda *_: None)
    wait_for(changed)
    assert publisher.matched
    assert not changed()
    assert publisher._asked() is publisher._asked()
    other.close()
    wait_for(changed)
    assert not publisher.matched
    publisher.close()
    assert changed() == [0]
    assert _batch.changed(pairs + pairs) == [0, 1]


def test_a_backend_tells_which_endpoints_have_changed(graph: Graph) -> None:
    """A peer that has come, matching or not, or that has gone, concerns the endpoints of its topic."""
    node, other = graph.node("node"), graph.node("other")
    endpoints = [node.advertise(topic, STRING, Qos()) for topic in ("/a", "/b")]
    told: set[Any] = set()

    def news() -> set[Any]:
        told.update(node.changed())
        return told

    def concerns(number: int) -> None:
        wait_for(lambda: endpoints[number] in news())
        told.clear()

    wait_for(lambda: news() >= set(endpoints) and not (told.clear() or node.changed()))  # all are new
    first = other.subscribe("/a", STRING, Qos(), lambda *_: None)
    wait_for(lambda: endpoints[0] in news())
    assert told == {endpoints[0]}
    told.clear()
    other.subscribe("/b", "std_msgs/msg/Int32", Qos(), lambda *_: None)
    concerns(1)
    wait_for(lambda: endpoints[1].status().code == "ROS003")
    concerns(1)  # what settled in time, and not with an event of DDS's
    first.close()
    concerns(0)
    assert endpoints[0].status().matched == 0
    endpoints[0].close()
    wait_for(lambda: not node.changed())


def test_without_the_library_anything_may_have_changed() -> None:
    """A process that uses no batches asks for each status."""
    program = "from rosplc.ros.dds import _batch; print(_batch.changed(bytes(24)))"
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    assert done.stdout == "[0, 1, 2]\n"


def test_big_endian_arrives_as_little_endian(graph: Graph) -> None:
    """A message of the other byte order is delivered in the usual one."""
    got: list[bytes] = []
    publisher = graph.node("talker").advertise("/number", "std_msgs/msg/UInt32", Qos())
    graph.node("listener").subscribe(
        "/number", "std_msgs/msg/UInt32", Qos(), lambda data, _: got.append(data)
    )
    wait_for(lambda: publisher.matched)
    publisher.write(b"\0\0\0\0" + struct.pack(">I", 123456))
    wait_for(lambda: got)
    assert got == [b"\0\1\0\0" + struct.pack("<I", 123456)]


def test_two_backends_share_a_domain(graph: Graph) -> None:
    """A domain lives as long as one of the backends in it, and can be entered again afterwards."""
    one, two = graph.node("one"), graph.node("two")
    one.close()
    publisher = two.advertise("/chatter", STRING, Qos())
    assert publisher.write(string("still here"))
    two.close()
    assert graph.node("three").advertise("/chatter", STRING, Qos()).write(string("again"))


def test_topic_is_created_once(graph: Graph, monkeypatch: pytest.MonkeyPatch) -> None:
    """A topic stays open with its type: creating it while types are removed crashes the library."""
    created: list[str] = []

    def create(participant: Any, name: str, data_type: Any) -> Any:
        created.append(name)
        return Topic(participant, name, data_type)

    monkeypatch.setattr(domain_module, "Topic", create)
    node = graph.node("one")
    for _ in range(3):
        node.subscribe("/chatter", STRING, Qos(), lambda *_: None).close()
        node.advertise("/chatter", STRING, Qos()).close()
    assert created == [ANNOUNCEMENT_TOPIC, "rt/chatter"]


def test_types_are_removed_under_the_lock_of_topic_creation(
    graph: Graph, monkeypatch: pytest.MonkeyPatch
) -> None:
    """While one node leaves, another one creates no topic."""
    one, other = graph.node("one"), graph.node("other")
    one.advertise("/chatter", STRING, Qos())
    deleting = threading.Event()
    delete = domain_module.native.delete

    def slowly(entity: Any) -> None:
        if isinstance(entity, Topic):
            deleting.set()
            assert not created.is_set()
        delete(entity)

    created = threading.Event()
    monkeypatch.setattr(domain_module.native, "delete", slowly)

    def create() -> None:
        deleting.wait()
        other.advertise("/other", STRING, Qos())
        created.set()

    thread = threading.Thread(target=create)
    thread.start()
    one.close()
    thread.join()
    assert created.is_set()


def test_large_messages_name_the_receive_buffer(
    graph: Graph, caplog: pytest.LogCaptureFixture, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A message beyond a default receive buffer is sent, and the log warns once."""
    monkeypatch.setattr("rosplc.ros.dds.endpoint.default_buffer", lambda: 1000)
    publisher = graph.node("node").advertise("/chatter", STRING, Qos())
    publisher.write(string("x" * 500))
    assert "net.core.rmem_default" not in caplog.text
    for _ in range(2):
        publisher.write(string("x" * 1500))
    assert caplog.text.count("net.core.rmem_default, 1000 bytes") == 1


def test_repetitions_fit_into_a_default_receive_buffer() -> None:
    """Cyclone takes a peer's buffer to be as large as its own; Fast DDS has the system's default."""
    domain = parsed({})
    assert domain.findtext("Internal/BurstSize/MaxRexmit") == "64KiB"
    assert domain.findtext("Internal/MaxQueuedRexmitBytes") == "16MB"


def test_nodes_find_the_bridge_soon_after_an_outage() -> None:
    """A node that gave the bridge up during an outage waits for its next announcement."""
    for reach in ("SUBNET", "LOCALHOST", "OFF", "SYSTEM_DEFAULT"):
        assert parsed({"ROS_AUTOMATIC_DISCOVERY_RANGE": reach}).findtext("Discovery/SPDPInterval") == "2s"
