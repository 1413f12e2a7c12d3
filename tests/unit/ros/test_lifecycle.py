"""A lifecycle backend: endpoints exist only while it is active."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import pytest

from rosplc.errors import BackendError, RosplcError
from rosplc.model import TypeStore
from rosplc.ros import LATCHED, SERVICES, Backend, Qos, Reply, open_backend
from rosplc.ros.lifecycle import LifecycleBackend
from tests.interop.graphs import STRING, Graph, free_domain, string, text_of
from tests.lib.waiting import wait_for

ADD = "diagnostic_msgs/srv/AddDiagnostics"


@pytest.fixture
def nodes() -> Iterator[tuple[LifecycleBackend, Backend]]:
    store = TypeStore.bundled("jazzy")
    with free_domain() as domain:
        managed = LifecycleBackend(open_backend("memory", store, "managed", domain=domain))
        other = open_backend("memory", store, "other", domain=domain)
        yield managed, other
        managed.close()
        other.close()


def test_nothing_is_carried_while_inactive(nodes: tuple[LifecycleBackend, Backend]) -> None:
    """While inactive there are no endpoints, nothing is received, and writing is refused."""
    managed, other = nodes
    got: list[bytes] = []
    subscription = managed.subscribe("/in", STRING, Qos(), lambda payload, _: got.append(payload))
    publisher = managed.advertise("/out", STRING, Qos())
    source = other.advertise("/in", STRING, Qos())
    source.write(string("unheard"))
    with pytest.raises(BackendError, match=r"/out: the node is not active.*ROS009"):
        publisher.write(string("unsaid"))
    assert source.matched == subscription.matched == publisher.matched == 0
    assert {status.reason for status in managed.status()} == {"the node is not active"}
    managed.activate()
    wait_for(lambda: source.matched)
    source.write(string("heard"))
    wait_for(lambda: got)
    assert got == [string("heard")]


def test_counts_outlive_an_activation(nodes: tuple[LifecycleBackend, Backend]) -> None:
    """What was sent in an earlier activation is still counted, and endpoints come and go with activations."""
    managed, other = nodes
    publisher = managed.advertise("/out", STRING, Qos())
    inbox = other.subscribe("/out", STRING, Qos(), lambda *_: None)
    for life in range(1, 3):
        managed.activate()
        assert publisher.write(string("x"))
        assert inbox.matched == 1
        assert publisher.status().sent == life
        managed.deactivate()
        assert inbox.matched == 0
        assert publisher.status().sent == life


def test_latched_messages_come_with_each_activation(nodes: tuple[LifecycleBackend, Backend]) -> None:
    """A latched topic's last message is received with each activation, as by any late subscriber."""
    managed, other = nodes
    got: list[bytes] = []
    other.advertise("/map", STRING, LATCHED).write(string("map"))
    managed.subscribe("/map", STRING, LATCHED, lambda payload, _: got.append(payload))
    for life in range(1, 3):
        managed.activate()
        wait_for(lambda n=life: len(got) == n)
        managed.deactivate()


@pytest.mark.parametrize("kind", ["memory", "dds"])
def test_latched_messages_are_sent_again_at_each_activation(kind: str) -> None:
    """A late subscriber gets the last message, even one that was refused while inactive."""
    if kind == "dds":
        pytest.importorskip("cyclonedds", reason="no wheel of cyclonedds for this machine")
    with free_domain() as domain:
        graph = Graph(kind, domain)
        managed = LifecycleBackend(graph.node("managed"), latched=["/map"])
        late = graph.node("late")
        publishers = [managed.advertise(topic, STRING, LATCHED) for topic in ("/map", "/plan")]
        managed.activate()
        for publisher in publishers:
            publisher.write(string("first"))
        managed.deactivate()
        managed.activate()

        def received(topic: str, count: int) -> list[str]:
            got: list[bytes] = []
            subscription = late.subscribe(topic, STRING, LATCHED, lambda payload, _: got.append(payload))
            wait_for(lambda: len(got) >= count)
            subscription.close()
            return [text_of(payload) for payload in got]

        assert received("/map", 1) == ["first"]
        managed.deactivate()
        refused = string("second")
        with pytest.raises(BackendError, match="ROS009"):
            publishers[0].write(refused)
        managed.activate()
        for publisher in publishers:
            assert publisher.write(refused)  # as a sender does that was refused
            assert publisher.write(string("third"))
        assert received("/map", 2) == received("/plan", 2) == ["second", "third"]
        graph.close()


def test_activation_that_fails_opens_nothing(nodes: tuple[LifecycleBackend, Backend]) -> None:
    """If one topic cannot be opened, none stays open, and the node stays inactive."""
    managed, other = nodes
    managed.advertise("/good", STRING, Qos())
    managed.advertise("/bad", "std_msgs/msg/Sting", Qos())
    inbox = other.subscribe("/good", STRING, Qos(), lambda *_: None)
    with pytest.raises(RosplcError, match="TYP001"):
        managed.activate()
    assert not managed.active
    assert inbox.matched == 0


def test_diagnostics_are_not_held_back(nodes: tuple[LifecycleBackend, Backend]) -> None:
    """An inactive bridge still tells how it is."""
    managed, other = nodes
    kind = "diagnostic_msgs/msg/DiagnosticArray"
    inbox = other.subscribe("/diagnostics", kind, Qos(), lambda *_: None)
    managed.advertise("/diagnostics", kind, Qos())
    assert inbox.matched == 1


def test_types_are_checked_at_once() -> None:
    """What the check refuses is refused while the node is inactive."""

    def check(type_name: str) -> None:
        raise BackendError("ROS011", type_name)

    inner = open_backend("memory", TypeStore.bundled("jazzy"), "node", domain=0)
    managed = LifecycleBackend(inner, check)
    with pytest.raises(BackendError, match="ROS011"):
        managed.advertise("/out", STRING, Qos())
    managed.close()


def test_endpoints_asked_for_while_active_open_at_once(nodes: tuple[LifecycleBackend, Backend]) -> None:
    """And what was closed for good does not come back with the next activation."""
    managed, other = nodes
    managed.activate()
    publisher = managed.advertise("/out", STRING, Qos())
    inbox = other.subscribe("/out", STRING, Qos(), lambda *_: None)
    assert inbox.matched == 1
    publisher.close()
    publisher.close()
    managed.deactivate()
    managed.activate()
    assert inbox.matched == 0
    assert (publisher.status().code, managed.status()) == ("ROS009", ())


def test_services_exist_while_active(nodes: tuple[LifecycleBackend, Backend]) -> None:
    """An inactive node neither serves nor calls; calls that are open at a deactivation end."""
    managed, other = nodes
    asked: list[bytes] = []
    server = managed.serve("/add", ADD, SERVICES, lambda _, caller, __: asked.append(caller))
    client = managed.client("/other", ADD, SERVICES)
    caller = other.client("/add", ADD, SERVICES)
    other.serve("/other", ADD, SERVICES, lambda *_: None)
    ends: list[tuple[str, str]] = []

    def receive(who: str) -> Callable[[Reply], None]:
        return lambda reply: ends.append((who, reply.outcome if reply.payload is None else "done"))

    caller.call(string("text"), receive("caller"))
    client.call(string("text"), receive("client"))
    assert ends == [("caller", "not executed"), ("client", "not executed")]
    assert not client.ready
    assert not server.present(bytes(16))
    managed.activate()
    wait_for(lambda: caller.ready and client.ready)
    caller.call(string("text"), receive("caller"))
    client.call(string("text"), receive("client"))
    wait_for(lambda: asked)
    assert server.present(asked[0])
    assert server.reply(asked[0], b"\0\1\0\0\1\0\0\0" + string("")[4:])
    wait_for(lambda: ("caller", "done") in ends)
    managed.deactivate()
    assert ends[-1] == ("client", "fate unknown")
    assert not caller.ready
    assert server.status().messages == client.status().messages == 1
