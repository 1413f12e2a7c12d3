"""What the DDS backend says about peers with settings that no ROS node has."""

from __future__ import annotations

import pytest

pytest.importorskip("cyclonedds", reason="no wheel of cyclonedds for this machine")

from cyclonedds.domain import DomainParticipant
from cyclonedds.pub import DataWriter
from cyclonedds.qos import Policy
from cyclonedds.qos import Qos as DdsQos
from cyclonedds.sub import DataReader, Subscriber
from cyclonedds.topic import Topic

from rosplc.ros import Qos
from rosplc.ros.dds import native
from rosplc.ros.dds.idl import IdlTypes
from tests.interop.graphs import STRING, Graph
from tests.lib.waiting import wait_for

XCDR1 = Policy.DataRepresentation(use_cdrv0_representation=True)


@pytest.mark.parametrize(
    ("policies", "words"),
    [
        (
            [Policy.DataRepresentation(use_xcdrv2_representation=True)],
            "it does not use XCDR version 1",
        ),
        ([XCDR1, Policy.Ownership.Exclusive], "it has exclusive ownership"),
        (
            [XCDR1, Policy.Durability.Transient, Policy.Reliability.Reliable(0)],
            "transient or persistent durability",
        ),
        ([XCDR1, Policy.Deadline(20_000_000)], "offers no deadline and the subscriber requests 20 ms"),
        ([XCDR1, Policy.Liveliness.ManualByTopic(2**63 - 1)], "it requests manual liveliness"),
        (
            [XCDR1, Policy.Liveliness.Automatic(50_000_000)],
            "no liveliness lease and the subscriber requests 50 ms",
        ),
    ],
    ids=lambda value: value if isinstance(value, str) else "",
)
def test_odd_settings_are_named(graph: Graph, policies: list[object], words: str) -> None:
    """A subscriber that wants what ROS does not offer is named with that."""
    publisher = graph.node("cell").advertise("/data", STRING, Qos())
    participant = DomainParticipant(graph.domain)
    topic = Topic(participant, "rt/data", IdlTypes(graph.store)[STRING])
    reader = DataReader(participant, topic, DdsQos(*policies))  # type: ignore[arg-type]
    wait_for(lambda: publisher.status().code == "ROS004")
    assert words in publisher.status().reason
    assert "a DDS participant without a ROS node" in publisher.status().reason
    assert publisher.matched == 0
    for entity in (reader, topic, participant):
        native.delete(entity)


def test_partition_is_named(graph: Graph) -> None:
    """A subscriber in a DDS partition is named with the partition."""
    publisher = graph.node("cell").advertise("/data", STRING, Qos())
    participant = DomainParticipant(graph.domain)
    topic = Topic(participant, "rt/data", IdlTypes(graph.store)[STRING])
    group = Subscriber(participant, DdsQos(Policy.Partition(["left", "right"])))
    reader = DataReader(group, topic, DdsQos(XCDR1))
    wait_for(lambda: publisher.status().code == "ROS004")
    assert "it is in the DDS partition left, right" in publisher.status().reason
    for entity in (reader, group, topic, participant):
        native.delete(entity)


def test_odd_but_harmless_settings_match(graph: Graph) -> None:
    """A publisher that offers more than ROS asks for is no problem."""
    subscription = graph.node("cell").subscribe("/data", STRING, Qos(), lambda *_: None)
    participant = DomainParticipant(graph.domain)
    topic = Topic(participant, "rt/data", IdlTypes(graph.store)[STRING])
    qos = DdsQos(
        XCDR1, Policy.Deadline(10**9), Policy.Durability.Transient, Policy.Liveliness.ManualByTopic(10**10)
    )
    writer = DataWriter(participant, topic, qos)
    wait_for(lambda: subscription.matched == 1)
    wait_for(lambda: subscription.status().code == "" and subscription.status().reason == "")
    for entity in (writer, topic, participant):
        native.delete(entity)


def test_unexplained_mismatch_is_another_definition(graph: Graph, monkeypatch: pytest.MonkeyPatch) -> None:
    """A peer that should match by all it announces, and does not for a while, has other fields."""
    graph.node("talker").advertise("/data", STRING, Qos())
    subscription = graph.node("listener").subscribe("/data", STRING, Qos(), lambda *_: None)
    wait_for(lambda: subscription.matched == 1)
    monkeypatch.setattr(subscription, "matched_handles", frozenset)
    wait_for(lambda: "node /talker" in subscription.status().reason)
    expected = f"node /talker publishes /data as {STRING}"
    assert (subscription.status().code, subscription.status().reason) == ("", f"{expected}, not matched yet")
    wait_for(lambda: subscription.status().code == "ROS003")
    assert subscription.status().reason == f"{expected} with another definition"
    monkeypatch.undo()
    wait_for(lambda: subscription.status().reason == "")


def test_a_topic_that_has_gone_takes_no_memory(graph: Graph) -> None:
    """Topics that come and go under ever new names leave nothing behind."""
    cell, other = graph.node("cell"), graph.node("other")
    table = cell.peers  # type: ignore[attr-defined]
    publisher = other.advertise("/data", STRING, Qos())
    wait_for(lambda: table.on("rt/data", "out"))
    publisher.close()
    wait_for(lambda: ("rt/data", "out") not in table._by_topic)
