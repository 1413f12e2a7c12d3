"""The Zenoh backend and zenoh-ros2-sdk, an independent implementation: values, both ways."""

from __future__ import annotations

import contextlib
import itertools
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest

pytest.importorskip("zenoh")
pytest.importorskip("zenoh_ros2_sdk")

from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from rosplc.model import TypeStore
from rosplc.ros import LATCHED, SERVICES, Backend, Qos, Reply, open_backend
from tests.interop.graphs import STRING, string, text_of
from tests.interop.zenoh.processes import Router, free_port
from tests.interop.zenoh.sdk import ADD, TRANSIENT_LOCAL, SdkInbox, SdkPeer
from tests.lib.waiting import repeat_until, wait_for

pytestmark = pytest.mark.verifies("zenoh", real="zenoh-ros2-sdk")

DOMAIN = 11
CUSTOM = "cell_msgs/msg/State"
DEFINITIONS = {
    "std_msgs/msg/String": "string data\n",
    "std_msgs/msg/Float64": "float64 data\n",
    CUSTOM: "int32 number\nfloat64[] values\nstring name\nbool[3] flags\nuint8[] raw\n",
}
VALUES: dict[str, list[dict[str, Any]]] = {
    "std_msgs/msg/String": [{"data": f"message {i}"} for i in range(5)],
    "std_msgs/msg/Float64": [{"data": i / 3} for i in range(5)],
    CUSTOM: [
        {
            "number": -i,
            "values": [i / 7, 1e300],
            "name": "x" * i,
            "flags": [True, False, True],
            "raw": [i, 255],
        }
        for i in range(5)
    ],
}
NUMBERS = itertools.count()
KINDS = {"values": np.float64, "flags": np.bool_, "raw": np.uint8}

# The oracle for values: another implementation of CDR, by another project.
ORACLE = get_typestore(Stores.ROS2_JAZZY)
ORACLE.register(get_types_from_msg(DEFINITIONS[CUSTOM], CUSTOM))


def fresh(name: str) -> str:
    """Return a name that nothing has had before: the processes outlive a test, also one that is repeated."""
    return f"/{name}{next(NUMBERS)}"


def serialized(kind: str, fields: dict[str, Any]) -> bytes:
    made = {k: np.array(v, KINDS[k]) if k in KINDS else v for k, v in fields.items()}
    data = bytes(ORACLE.serialize_cdr(ORACLE.types[kind](**made), kind))
    return data + bytes(-len(data) % 4)


@pytest.fixture(scope="module")
def port() -> Iterator[int]:
    with free_port() as number, Router(number):
        yield number


@pytest.fixture(params=["peer", "client"], scope="module")
def node(request: pytest.FixtureRequest, port: int) -> Iterator[Backend]:
    store = TypeStore.bundled("jazzy").with_definition(CUSTOM, DEFINITIONS[CUSTOM])
    options = {"mode": request.param, "connect": [f"tcp/127.0.0.1:{port}"]}
    backend = open_backend("zenoh", store, "cell", domain=DOMAIN, options=options, environment={})
    yield backend
    backend.close()


@pytest.fixture(scope="module")
def sdk(node: Backend, port: int) -> Iterator[SdkPeer]:
    with SdkPeer(port, DOMAIN) as peer:
        settle(node, peer)
        yield peer


def settle(node: Any, sdk: SdkPeer) -> None:
    """Wait until two peers have a link of their own: what is under way while they move to it is lost."""
    topic, back = fresh("settle"), fresh("back")
    got: list[bytes] = []
    subscription = node.subscribe(topic, STRING, Qos(), lambda data, _: got.append(data))
    publisher, outbox, inbox = node.advertise(back, STRING, Qos()), sdk.advertise(topic), sdk.subscribe(back)
    if node._link._config.mode == "peer":
        with contextlib.suppress(AssertionError):  # they stay at the router
            wait_for(node._link._session.info.peers_zid, seconds=20)
    before = len(got), len(inbox.messages)

    def send() -> None:
        publisher.write(string("settle"))
        outbox.publish({"data": "settle"}, wait=False)

    repeat_until(send, lambda: len(got) > before[0] and len(inbox.messages) > before[1])
    subscription.close()
    publisher.close()


@pytest.mark.parametrize("kind", DEFINITIONS)
def test_values_from_the_sdk(node: Backend, sdk: SdkPeer, kind: str) -> None:
    """What the SDK publishes arrives value by value, from a type hash that both computed themselves."""
    got: list[bytes] = []
    topic = fresh("from")
    subscription = node.subscribe(topic, kind, Qos(depth=100), lambda data, _: got.append(data))
    outbox = sdk.advertise(topic, kind, definition=DEFINITIONS[kind])
    outbox.publish(*VALUES[kind])
    wait_for(lambda: len(got) == 5)
    assert [data + bytes(-len(data) % 4) for data in got] == [serialized(kind, f) for f in VALUES[kind]]
    status = subscription.status()
    assert (status.matched, status.rejected, status.dropped) == (1, 0, 0)


@pytest.mark.parametrize("kind", DEFINITIONS)
def test_values_to_the_sdk(node: Backend, sdk: SdkPeer, kind: str) -> None:
    """What the backend publishes arrives at the SDK value by value, in order, from the first one on."""
    topic = fresh("to")
    publisher = node.advertise(topic, kind, Qos(depth=100))
    inbox = sdk.subscribe(topic, kind, definition=DEFINITIONS[kind])
    wait_for(lambda: publisher.matched == 1)
    for fields in VALUES[kind]:
        assert publisher.write(serialized(kind, fields))
    wait_for(lambda: len(inbox.messages) == 5)
    assert inbox.messages == VALUES[kind]


def test_one_message_is_enough(node: Backend, sdk: SdkPeer) -> None:
    """What is sent once, in the moment in which a subscriber has matched, arrives."""
    for topic in [fresh("once") for _ in range(10)]:
        publisher = node.advertise(topic, STRING, Qos())
        inbox = sdk.subscribe(topic, wait=False)
        while not publisher.matched:
            pass
        assert publisher.write(string("once"))
        wait_for(lambda i=inbox: i.messages)
        assert inbox.messages == [{"data": "once"}]


def test_late_sdk_subscriber_gets_the_newest(node: Backend, sdk: SdkPeer) -> None:
    """The SDK asks our cache; it keeps one answer per key, so that it shows the newest message alone."""
    # What is under way while it subscribes may be lost (it asks for the cache once, and links between peers
    # and router may just change) or may still be delivered live: then a further late subscriber asks, on a
    # topic that no earlier one has heard. That it never comes ends with pytest's timeout.
    for topic in map(fresh, itertools.repeat("chart")):
        publisher = node.advertise(topic, STRING, Qos(durability="transient_local", depth=10))
        for number in range(5):
            publisher.write(string(str(number)))
        inbox = sdk.subscribe(topic, qos=TRANSIENT_LOCAL)
        with contextlib.suppress(AssertionError):
            wait_for(lambda publisher=publisher, inbox=inbox: publisher.matched and inbox.messages, seconds=5)
            repeat_until(lambda p=publisher: p.write(string("now")), lambda i=inbox: len(i.messages) > 1)
        if [message["data"] for message in inbox.messages[:2]] == ["4", "now"]:
            return


def test_sdk_publisher_without_a_cache(node: Backend, sdk: SdkPeer) -> None:
    """The SDK says transient_local and keeps nothing: our late subscription hears what comes then."""
    topic = fresh("map")
    outbox = sdk.advertise(topic, qos=TRANSIENT_LOCAL)
    outbox.publish({"data": "old"}, wait=False)
    sdk.advertise(fresh("done"))  # it does one thing after the other
    got: list[bytes] = []
    subscription = node.subscribe(topic, STRING, LATCHED, lambda data, _: got.append(data))
    wait_for(lambda: subscription.matched)
    outbox.publish({"data": "new"})
    wait_for(lambda: got)
    assert list(map(text_of, got)) == ["new"]


def test_sdk_peer_that_leaves_is_missed(node: Backend, port: int) -> None:
    """When an SDK process ends, nobody is matched any more, and its node is gone from the graph."""
    topic = fresh("left")
    subscription = node.subscribe(topic, STRING, Qos(), lambda *_: None)
    with SdkPeer(port, DOMAIN) as peer:
        peer.advertise(topic)
        wait_for(lambda: subscription.matched == 1)
        (leaving,) = [end.node for end in node.graph().endpoints if end.topic == topic]
        assert leaving in node.graph().nodes
    wait_for(lambda: subscription.matched == 0)
    wait_for(lambda: leaving not in node.graph().nodes)


def test_the_sdk_calls(node: Backend, sdk: SdkPeer) -> None:
    """Its requests arrive under the hash that both computed, and the answers reach their calls."""
    asked: list[tuple[bytes, bytes]] = []
    service = fresh("from_sdk")
    server = node.serve(service, ADD, SERVICES, lambda payload, caller, _: asked.append((payload, caller)))
    inbox = repeat_first(sdk, service, asked)
    for number in range(5):
        sdk.call(service, str(number))
    wait_for(lambda: {text_of(payload) for payload, _ in asked} >= set("01234"))
    for payload, caller in reversed(asked):
        assert server.present(caller)
        assert server.reply(caller, b"\0\1\0\0\1\0\0\0" + payload[4:])
    texts = {text_of(payload) for payload, _ in asked}
    # The SDK shows None for a call that has failed, such as one before the server was known.
    wait_for(lambda: {message["message"] for message in inbox.messages if message} == texts)
    server.close()


def repeat_first(sdk: SdkPeer, service: str, asked: list[tuple[bytes, bytes]]) -> SdkInbox:
    """Call until a request has arrived: the SDK does not wait for a server."""
    inbox = sdk.call(service, "first")
    repeat_until(lambda: sdk.call(service, "first"), lambda: asked, every=0.5)
    return inbox


def test_the_sdk_is_called(node: Backend, sdk: SdkPeer) -> None:
    """The client finds the SDK's server by its token, and each call gets its answer."""
    service = fresh("to_sdk")
    client = node.client(service, ADD, SERVICES)
    inbox = sdk.serve(service)
    wait_for(lambda: client.ready)
    replies: dict[int, Reply] = {}
    for number in range(5):
        client.call(string(str(number)), lambda reply, n=number: replies.update({n: reply}))  # type: ignore[misc]
    wait_for(lambda: len(replies) == 5)
    answers = {number: text_of(b"\0\1\0\0" + (reply.payload or b"")[8:]) for number, reply in replies.items()}
    assert answers == {number: str(number) for number in range(5)}
    wait_for(lambda: len(inbox.messages) >= 5, "the server's own words")
    assert sorted(message["load_namespace"] for message in inbox.messages) == list("01234")
    client.close()
