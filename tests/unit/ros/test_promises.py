"""Deadline and lease: what is promised about the coming of messages, over real DDS."""

from __future__ import annotations

import os
import subprocess
import sys

import pytest

pytest.importorskip("cyclonedds", exc_type=ImportError)

from rosplc.bridge.engine import Bridge
from rosplc.config import ConfigErrors, parse_config, resolve
from rosplc.errors import BackendError
from rosplc.model import TypeStore
from rosplc.ros import Qos, incompatibility
from rosplc.ros.memory import open_backend as open_memory
from tests.interop.graphs import LOCAL, Graph
from tests.lib.waiting import wait_for

INT = "std_msgs/msg/Int32"
MS = 1_000_000


@pytest.mark.parametrize(
    ("offered", "requested", "words"),
    [
        (Qos(), Qos(), None),
        (Qos(deadline_ns=5 * MS), Qos(), None),
        (Qos(deadline_ns=5 * MS), Qos(deadline_ns=5 * MS), None),
        (
            Qos(deadline_ns=6 * MS),
            Qos(deadline_ns=5 * MS),
            "offers a deadline of 6 ms and the subscriber requests",
        ),
        (Qos(), Qos(deadline_ns=5 * MS), "offers no deadline and the subscriber requests 5 ms"),
        (Qos(lease_ns=5 * MS), Qos(lease_ns=9 * MS), None),
        (
            Qos(deadline_ns=MS),
            Qos(lease_ns=9 * MS),
            "offers no liveliness lease and the subscriber requests 9 ms",
        ),
    ],
)
def test_who_wants_more_than_is_offered_does_not_match(
    offered: Qos, requested: Qos, words: str | None
) -> None:
    """DDS' rule: what is offered is at least as good as what is asked for."""
    found = incompatibility(offered, requested)
    assert found is None if words is None else words in str(found)


@pytest.mark.parametrize("value", [-1, 1.5, True, 2**63])
def test_times_are_whole_nanoseconds(value: object) -> None:
    """Anything else is refused where it is made."""
    for name in ("deadline_ns", "lease_ns"):
        with pytest.raises(BackendError, match="ROS007"):
            Qos(**{name: value})  # type: ignore[arg-type]


def test_a_missed_deadline_is_counted_on_both_sides(graph: Graph) -> None:
    """Publisher and subscriber know that a message is late; one that is promised nothing counts nothing."""
    qos = Qos(deadline_ns=20 * MS)
    publisher = graph.node("talker").advertise("/data", INT, qos)
    subscription = graph.node("listener").subscribe("/data", INT, qos, lambda *_: None)
    careless = graph.node("careless").subscribe("/data", INT, Qos(), lambda *_: None)
    wait_for(lambda: subscription.matched == careless.matched == 1)
    publisher.write(b"\0\1\0\0\1\0\0\0")
    wait_for(lambda: subscription.status().late > 1)
    wait_for(lambda: publisher.status().late > 1)
    assert careless.status().late == 0


def test_who_offers_no_deadline_is_named(graph: Graph) -> None:
    """A publisher without the promise is not received from, and the status says why."""
    graph.node("talker").advertise("/data", INT, Qos())
    subscription = graph.node("listener").subscribe("/data", INT, Qos(deadline_ns=20 * MS), lambda *_: None)
    wait_for(lambda: subscription.status().code == "ROS004")
    assert (
        "the publisher offers no deadline and the subscriber requests 20 ms" in subscription.status().reason
    )
    assert subscription.matched == 0


_VICTIM = f"""
import sys, time
from rosplc.model import TypeStore
from rosplc.ros import Qos, open_backend
node = open_backend("dds", TypeStore.bundled("jazzy"), "victim", domain=int(sys.argv[1]))
publisher = node.advertise("/data", "{INT}", Qos(lease_ns=500_000_000))
time.sleep(1000)
"""


def test_a_killed_publisher_is_missed_by_its_lease(graph: Graph) -> None:
    """It counts as gone when its lease is over, though the middleware still lists its process."""
    subscription = graph.node("cell").subscribe("/data", INT, Qos(lease_ns=500 * MS), lambda *_: None)
    victim = subprocess.Popen([sys.executable, "-c", _VICTIM, str(graph.domain)], env={**os.environ, **LOCAL})
    try:
        wait_for(lambda: subscription.matched == 1)
    finally:
        victim.kill()
        victim.wait()
    wait_for(lambda: subscription.matched == 0)


def test_the_configuration_hands_them_on() -> None:
    """Both are in the plan; other backends are refused with the key, not silently without effect."""
    entry = f"type: {INT}, to: plc, qos: {{deadline: 20Hz, lease: 1s}}"
    (plan,) = resolve(parse_config(f"topics:\n  /a: {{{entry}}}\n")).topics
    assert (plan.qos.deadline_ns, plan.qos.lease_ns) == (50 * MS, 1000 * MS)
    with pytest.raises(ConfigErrors) as caught:
        resolve(parse_config(f"ros: {{backend: memory}}\ntopics:\n  /a: {{{entry}}}\n", name="c.yaml"))
    assert caught.value.errors[0].where == "c.yaml:3: topics./a.qos"
    assert "ros.backend is memory" in caught.value.errors[0].what


def test_a_backend_that_auto_chose_is_refused(tmp_path: object) -> None:
    """A bridge does not start without what its configuration relies on (ROS019)."""
    topics = f"topics:\n  /a: {{type: {INT}, to: plc, qos: {{lease: 1s}}}}\n"
    text = f"prefix: Tpromise\nshm: {{directory: {tmp_path}}}\n{topics}"
    backend = open_memory(TypeStore.bundled("jazzy"), "bridge", domain=97)
    try:
        with pytest.raises(BackendError, match="ROS019"):
            Bridge(parse_config(text), backend).start()
    finally:
        backend.close()
