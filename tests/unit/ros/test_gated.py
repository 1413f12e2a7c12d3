"""A backend behind a gate: endpoints exist only while it is active."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from rosplc.errors import BackendError, RosplcError
from rosplc.model import TypeStore
from rosplc.ros import LATCHED, Backend, Qos, open_backend
from rosplc.ros.gated import GatedBackend
from tests.interop.graphs import STRING, free_domain, string
from tests.lib.waiting import wait_for

pytestmark = pytest.mark.timeout(60)


@pytest.fixture
def nodes() -> Iterator[tuple[GatedBackend, Backend]]:
    store = TypeStore.bundled("jazzy")
    with free_domain() as domain:
        gated = GatedBackend(open_backend("memory", store, "gated", domain=domain))
        other = open_backend("memory", store, "other", domain=domain)
        yield gated, other
        gated.close()
        other.close()


def test_nothing_passes_a_closed_gate(nodes: tuple[GatedBackend, Backend]) -> None:
    """While inactive there are no endpoints, nothing is received, and writing is refused."""
    gated, other = nodes
    got: list[bytes] = []
    subscription = gated.subscribe("/in", STRING, Qos(), lambda payload, _: got.append(payload))
    publisher = gated.advertise("/out", STRING, Qos())
    source = other.advertise("/in", STRING, Qos())
    source.write(string("unheard"))
    with pytest.raises(BackendError, match=r"/out: the node is not active.*ROS009"):
        publisher.write(string("unsaid"))
    assert source.matched == subscription.matched == publisher.matched == 0
    assert {status.reason for status in gated.status()} == {"the node is not active"}
    gated.activate()
    wait_for(lambda: source.matched)
    source.write(string("heard"))
    wait_for(lambda: got)
    assert got == [string("heard")]


def test_counts_outlive_an_activation(nodes: tuple[GatedBackend, Backend]) -> None:
    """What was sent in an earlier activation is still counted, and endpoints come and go with the gate."""
    gated, other = nodes
    publisher = gated.advertise("/out", STRING, Qos())
    inbox = other.subscribe("/out", STRING, Qos(), lambda *_: None)
    for life in range(1, 3):
        gated.activate()
        assert publisher.write(string("x"))
        assert inbox.matched == 1
        assert publisher.status().sent == life
        gated.deactivate()
        assert inbox.matched == 0
        assert publisher.status().sent == life


def test_latched_messages_come_with_each_activation(nodes: tuple[GatedBackend, Backend]) -> None:
    """A latched topic's last message is received when the gate opens, as by any late subscriber."""
    gated, other = nodes
    got: list[bytes] = []
    other.advertise("/map", STRING, LATCHED).write(string("map"))
    gated.subscribe("/map", STRING, LATCHED, lambda payload, _: got.append(payload))
    for life in range(1, 3):
        gated.activate()
        wait_for(lambda n=life: len(got) == n)
        gated.deactivate()


def test_activation_that_fails_opens_nothing(nodes: tuple[GatedBackend, Backend]) -> None:
    """If one topic cannot be opened, none stays open, and the gate stays closed."""
    gated, other = nodes
    gated.advertise("/good", STRING, Qos())
    gated.advertise("/bad", "std_msgs/msg/Sting", Qos())
    inbox = other.subscribe("/good", STRING, Qos(), lambda *_: None)
    with pytest.raises(RosplcError, match="TYP001"):
        gated.activate()
    assert not gated.active
    assert inbox.matched == 0


def test_diagnostics_are_not_held_back(nodes: tuple[GatedBackend, Backend]) -> None:
    """An inactive bridge still tells how it is."""
    gated, other = nodes
    kind = "diagnostic_msgs/msg/DiagnosticArray"
    inbox = other.subscribe("/diagnostics", kind, Qos(), lambda *_: None)
    gated.advertise("/diagnostics", kind, Qos())
    assert inbox.matched == 1


def test_types_are_checked_at_once() -> None:
    """What the check refuses is refused while the gate is closed."""

    def check(type_name: str) -> None:
        raise BackendError("ROS011", type_name)

    inner = open_backend("memory", TypeStore.bundled("jazzy"), "node", domain=0)
    gated = GatedBackend(inner, check)
    with pytest.raises(BackendError, match="ROS011"):
        gated.advertise("/out", STRING, Qos())
    gated.close()


def test_endpoints_asked_for_while_active_open_at_once(nodes: tuple[GatedBackend, Backend]) -> None:
    """And what was closed for good does not come back with the next activation."""
    gated, other = nodes
    gated.activate()
    publisher = gated.advertise("/out", STRING, Qos())
    inbox = other.subscribe("/out", STRING, Qos(), lambda *_: None)
    assert inbox.matched == 1
    publisher.close()
    publisher.close()
    gated.deactivate()
    gated.activate()
    assert inbox.matched == 0
    assert (publisher.status().code, gated.status()) == ("ROS009", ())
