"""The Zenoh backend beside a session of the bare library that does as rmw_zenoh's sources say."""

from __future__ import annotations

import itertools
import logging
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from typing import Any

import pytest

pytest.importorskip("zenoh")

import zenoh
import zenoh.ext

from rosplc.model import TypeStore
from rosplc.ros import LATCHED, Backend, Qos, open_backend
from rosplc.ros.zenoh.backend import session_config
from tests.interop.graphs import STRING, string, text_of
from tests.interop.zenoh.processes import Router, free_port
from tests.lib.waiting import wait_for

pytestmark = pytest.mark.verifies("zenoh", real="eclipse-zenoh")

DOMAIN = 17
STORE = TypeStore.bundled("jazzy")
HASH = STORE.type_hash(STRING)
DDS = "std_msgs::msg::dds_::String_"
LATCHED_QOS = ":1:,10:,:,:,,"


class RawPeer:
    """A node of nobody's: what it declares is written out here, by rmw_zenoh's ``docs/design.md``."""

    def __init__(self, router: Router, mode: str = "peer") -> None:
        self.session: Any = zenoh.open(
            session_config({"mode": mode, "connect": [router.endpoint]}, {}).config
        )
        self._numbers = itertools.count(1)
        self._kept: list[Any] = []
        self.token(f"{self._head(0)}/NN/%/%/raw")

    def _head(self, entity: int) -> str:
        return f"@ros2_lv/{DOMAIN}/{self.session.zid()}/0/{entity}"

    def token(self, key: str) -> None:
        """Declare a liveliness token."""
        self._kept.append(self.session.liveliness().declare_token(key))

    def show(self, kind: str, topic: str, qos: str = "::,10:,:,:,,") -> None:
        """Declare an endpoint's token, and nothing else."""
        number = next(self._numbers)
        self.token(f"{self._head(number)}/{kind}/%/%/raw/%{topic.strip('/')}/{DDS}/{HASH}/{qos}")

    @staticmethod
    def key(topic: str) -> str:
        return f"{DOMAIN}/{topic.strip('/')}/{DDS}/{HASH}"

    def listen(self, topic: str) -> list[str]:
        """Receive a topic as a volatile subscriber."""
        heard: list[str] = []
        key = self.key(topic)
        self._kept.append(
            self.session.declare_subscriber(key, lambda s: heard.append(text_of(s.payload.to_bytes())))
        )
        return heard

    def listen_late(self, topic: str) -> list[str]:
        """Receive a topic as rmw_zenoh's reliable and transient_local subscriptions do."""
        heard: list[str] = []
        self._kept.append(
            zenoh.ext.declare_advanced_subscriber(
                self.session,
                self.key(topic),
                lambda s: heard.append(text_of(s.payload.to_bytes())),
                history=zenoh.ext.HistoryConfig(detect_late_publishers=True, max_samples=10),
                recovery=zenoh.ext.RecoveryConfig(heartbeat=True),
                subscriber_detection=True,
            )
        )
        self.show("MS", topic, LATCHED_QOS)
        return heard

    def keep(self, topic: str) -> Any:
        """Send a topic as rmw_zenoh's reliable and transient_local publishers do."""
        publisher = zenoh.ext.declare_advanced_publisher(
            self.session,
            self.key(topic),
            cache=zenoh.ext.CacheConfig(10),
            publisher_detection=True,
            sample_miss_detection=zenoh.ext.MissDetectionConfig(sporadic_heartbeat=0.5),
        )
        self._kept.append(publisher)
        self.show("MP", topic, LATCHED_QOS)
        return publisher


def attachment(sequence: int, stamp: int = 1, gid: bytes = bytes(range(16))) -> bytes:
    """Return an attachment: two 64-bit numbers, a length, and an id."""
    return sequence.to_bytes(8, "little") + stamp.to_bytes(8, "little") + bytes([len(gid)]) + gid


@pytest.fixture
def router() -> Iterator[Router]:
    with free_port() as port, Router(port) as router:
        yield router


def opened(router: Router, mode: str = "peer", name: str = "cell") -> Backend:
    options = {"mode": mode, "connect": [router.endpoint]}
    return open_backend("zenoh", STORE, name, domain=DOMAIN, options=options, environment={})


@pytest.fixture(params=["peer", "client"])
def node(request: pytest.FixtureRequest, router: Router) -> Iterator[Backend]:
    backend = opened(router, request.param)
    yield backend
    backend.close()


@pytest.fixture
def raw(router: Router) -> Iterator[RawPeer]:
    peer = RawPeer(router)
    yield peer
    peer.session.close()


# -- who is there


def test_subscriber_counts_when_messages_reach_it(node: Backend, raw: RawPeer) -> None:
    """A token without a subscriber matches nobody; with it, the very first message arrives."""
    publisher = node.advertise("/data", STRING, Qos())
    raw.show("MS", "/data")
    raw.show("MS", "/marker")  # later news, of which none is passed over
    wait_for(lambda: {"/data", "/marker"} <= set(node.graph().topics) and "/raw" in node.graph().nodes)
    assert publisher.matched == 0
    assert publisher.status().reason == "Zenoh is still connecting"
    heard = raw.listen("/data")
    wait_for(lambda: publisher.matched == 1)
    assert publisher.write(string("first"))
    wait_for(lambda: heard)
    assert heard == ["first"]
    assert publisher.status().reason == ""


# -- those who come late


def test_late_subscriber_gets_what_is_kept(node: Backend, raw: RawPeer) -> None:
    """An advanced subscriber, as rmw_zenoh's, gets what the publisher keeps, in order, then what is new."""
    publisher = node.advertise("/map", STRING, Qos(durability="transient_local", depth=3))
    early = raw.listen_late("/map")
    wait_for(lambda: publisher.matched == 1)
    for number in range(5):
        publisher.write(string(str(number)))
    wait_for(lambda: "4" in early)  # none is on its way any more
    heard = raw.listen_late("/map")
    wait_for(lambda: len(heard) >= 3)
    publisher.write(string("now"))
    wait_for(lambda: "now" in heard)
    assert heard == ["2", "3", "4", "now"]


def test_late_subscription_gets_what_a_peer_keeps(node: Backend, raw: RawPeer) -> None:
    """What an advanced publisher keeps reaches our late subscription, with its stamps, in order."""
    publisher = raw.keep("/map")
    for number in range(1, 6):
        publisher.put(string(str(number)), attachment=attachment(number, 1000 + number))
    got: list[tuple[str, int]] = []
    subscription = node.subscribe("/map", STRING, LATCHED, lambda d, stamp: got.append((text_of(d), stamp)))
    wait_for(lambda: len(got) == 5)
    assert got == [(str(number), 1000 + number) for number in range(1, 6)]
    publisher.put(string("now"), attachment=attachment(6, 2000))
    wait_for(lambda: len(got) == 6)
    assert got[-1] == ("now", 2000)
    assert subscription.status().dropped == 0


# -- who means no good

HOSTILE_TOKENS = (
    f"@ros2_lv/{DOMAIN}",
    f"@ros2_lv/{DOMAIN}/a",
    f"@ros2_lv/{DOMAIN}/a/0/1/XX/%/%/evil",
    f"@ros2_lv/{DOMAIN}/a/0/1/MP/%/%/evil",
    f"@ros2_lv/{DOMAIN}/a/0/1/MP/%/%/evil/%data/{DDS}/{HASH}/::",
    f"@ros2_lv/{DOMAIN}/a/0/1/MP/%/%/evil/%data/{DDS}/{HASH}/9:9:9,x",
    f"@ros2_lv/{DOMAIN}/a/0/1/MP/%/%/evil/%data/{DDS}/{HASH}/::,{'9' * 1500}:,:,:,,",
    f"@ros2_lv/{DOMAIN}/a/0/1/MP/%/%/evil/%data/{DDS}/{HASH}/::,{'9' * 5000}:,:,:,,",
    f"@ros2_lv/{DOMAIN}/a/0/1/MS/%/%/evil/%data/{'T' * 5000}/{HASH}/::,1:,:,:,,",
    f"@ros2_lv/{DOMAIN}/a/0/1/MS/%/%1/e vil/%da ta/{DDS}/{HASH}/::,1:,:,:,,",
    f"@ros2_lv/{DOMAIN}/a/0/1/MS/%/%/\x1b[31mevil/%data/{DDS}/{HASH}/::,1:,:,:,,",
    f"@ros2_lv/{DOMAIN}/a/0/1/NN/%/%/ev\u202eil",
    f"@ros2_lv/{DOMAIN}/{'a' * 200}/0/1/NN/%/%/evil",
    f"@ros2_lv/{DOMAIN}/" + "/".join("x" * 500),
)


def test_hostile_tokens_are_refused(
    node: Backend, raw: RawPeer, router: Router, caplog: pytest.LogCaptureFixture
) -> None:
    """Whatever a peer announces, the graph shows real nodes alone, one warning is logged, and all goes on."""
    got: list[bytes] = []
    subscription = node.subscribe("/data", STRING, Qos(), lambda data, _: got.append(data))
    with caplog.at_level(logging.WARNING, "rosplc.ros.zenoh"):
        for key in HOSTILE_TOKENS:
            raw.token(key)
        raw.show("MP", "/data")
        # One token says a depth of fifteen hundred digits: it is taken as the largest there is.
        wait_for(lambda: subscription.matched == 2)
        wait_for(lambda: node.tokens.malformed >= len(HOSTILE_TOKENS) - 1)  # type: ignore[attr-defined]
    assert node.graph().nodes == ("/raw",)
    assert set(node.graph().topics) == {"/data"}
    refused = [
        record.getMessage() for record in caplog.records if "which is not from a ROS node" in record.msg
    ]
    assert len(refused) == 1
    assert refused[0].isprintable()
    publisher = raw.session.declare_publisher(raw.key("/data"))
    wait_for(lambda: publisher.matching_status.matching)
    publisher.put(string("still here"), attachment=attachment(1))
    wait_for(lambda: got)


@pytest.mark.parametrize("kind", ["volatile", "transient_local"])
def test_hostile_messages_are_counted(node: Backend, raw: RawPeer, kind: Any) -> None:
    """Messages without a header, a proper attachment or any bytes at all are counted, and nothing else."""
    got: list[bytes] = []
    qos = Qos(durability=kind, depth=10)
    subscription = node.subscribe("/data", STRING, qos, lambda data, _: got.append(data))
    publisher = raw.session.declare_publisher(raw.key("/data"))
    wait_for(lambda: publisher.matching_status.matching)
    good = string("x")
    bad: list[tuple[bytes, bytes | None]] = [(good, head) for head in (None, b"", bytes(16), bytes(33))]
    bad += [(good, attachment(1, gid=bytes(4))), (good, attachment(1 << 63)), (good, attachment(1, 1 << 63))]
    bad += [(data, attachment(1)) for data in (b"", b"\0", b"\xff\1\0\0", b"\0\7\0\0" + bytes(60))]
    for data, head in bad:
        publisher.put(data, attachment=head)
    publisher.delete()
    publisher.put(good, attachment=attachment(2))
    wait_for(lambda: got)
    assert got == [good]
    status = subscription.status()
    assert (status.received, status.rejected) == (1, len(bad) + 1)


def test_peer_that_stands_still_holds_nobody_up(router: Router) -> None:
    """While one subscriber is stopped and its link full, messages go on to another, of any size."""
    token = f"/0/1/MS/%/%/still/%data/{DDS}/{HASH}/::,9:,:,:,,"
    code = (
        "import sys, zenoh\n"
        "from rosplc.ros.zenoh.backend import session_config\n"
        f"s = zenoh.open(session_config({{'connect': [{router.endpoint!r}]}}, {{}}).config)\n"
        f"u = s.declare_subscriber({RawPeer.key('/data')!r}, lambda _: None)\n"
        f"t = s.liveliness().declare_token(f'@ros2_lv/{DOMAIN}/{{s.zid()}}{token}')\n"
        "sys.stdin.read()\n"
    )
    node, other = opened(router), opened(router, name="other")
    child = subprocess.Popen([sys.executable, "-c", code], stdin=subprocess.PIPE)
    try:
        got: list[bytes] = []
        publisher = node.advertise("/data", STRING, Qos())
        other.subscribe("/data", STRING, Qos(depth=5), lambda data, _: got.append(data))
        wait_for(lambda: publisher.matched == 2)
        os.kill(child.pid, signal.SIGSTOP)
        for size in (1000, 300_000):
            payload = string("x" * size)
            for _ in range(300_000_000 // (size * 100)):
                assert publisher.write(payload)
        del got[:]
        while not got:  # the other one may have been busy with what came before
            publisher.write(string("on and on"))
            time.sleep(0.01)
    finally:
        child.kill()
        child.communicate()
        node.close()
        other.close()


# -- the order of starting


@pytest.mark.parametrize("mode", ["peer", "client"])
def test_node_starts_before_its_router(mode: str) -> None:
    """A node that starts alone says ROS016, connects when its router comes, and sends what it kept."""
    with free_port() as port:
        router = Router(port)
        node = opened(router, mode)
        try:
            publisher = node.advertise("/map", STRING, LATCHED)
            got: list[bytes] = []
            node.subscribe("/data", STRING, Qos(), lambda data, _: got.append(data))
            assert publisher.write(string("early"))
            status = publisher.status()
            assert status.code == "ROS016"
            assert f"no Zenoh router answers at {router.endpoint}" in status.reason
            with router:
                raw = RawPeer(router)
                heard = raw.listen_late("/map")
                wait_for(lambda: heard)
                wait_for(lambda: publisher.status().reason == "")
                assert heard == ["early"]
                to = raw.session.declare_publisher(raw.key("/data"))
                wait_for(lambda: to.matching_status.matching)
                to.put(string("hello"), attachment=attachment(1))
                wait_for(lambda: got)
                raw.session.close()
        finally:
            node.close()
