"""What other participants say over DDS: announcements of nodes, type names, user data, QoS in words."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Literal

from rosplc.errors import BackendError
from rosplc.model import TypeStore
from rosplc.ros import EndpointInfo
from rosplc.ros._base import explain
from rosplc.ros.backend import Qos
from rosplc.ros.dds.idl import dds_topic, ros_topic
from rosplc.ros.dds.peers import (
    NodeEntities,
    decode_announcement,
    encode_announcement,
    type_hash_in,
)
from rosplc.ros.names import dds_type_name, ros_type_name
from tests.fuzz.choices import Choices

__all__ = ["check", "seeds"]


def _announcement(choices: Choices) -> None:
    types = TypeStore.bundled("humble" if choices.flag() else "jazzy")
    data = choices.rest()
    try:
        participant, nodes = decode_announcement(types, data)
    except BackendError as error:
        assert len(str(error)) < 400
        return
    assert len(participant) == 16
    assert sum(len(node.readers) + len(node.writers) for node in nodes) * 16 <= len(data)
    for node in nodes:
        assert node.full_name.startswith("/"), node
        assert len(node.full_name) <= 2 + 2 * 6 * 256  # a byte takes six characters at most
        assert node.full_name.isprintable()
    again = decode_announcement(types, encode_announcement(types, participant, nodes))
    assert again == (participant, nodes)


def _peer(choices: Choices) -> None:
    topic, kind, name = choices.text(), choices.text(), choices.text()
    type_hash = type_hash_in(choices.part())
    qos = Qos("best_effort" if choices.flag() else "reliable", "volatile", 1)
    way: Literal["in", "out"] = "out" if choices.flag() else "in"
    peer = EndpointInfo(topic, ros_type_name(kind), way, "", qos, type_hash, (choices.text(),))
    ours = EndpointInfo("/t", "std_msgs/msg/String", "in", "", Qos(), "RIHS01_" + "0" * 64)
    words = explain(peer, ours, name, matched=choices.flag())
    assert words is None or words[0] in ("ROS003", "ROS004")
    own = ros_topic(topic)
    assert own is None or dds_topic(own) == topic
    if ros_type_name(kind) != kind and kind.split("::")[1] == "msg":
        assert dds_type_name(ros_type_name(kind)) == kind


def check(data: bytes) -> None:
    """Whatever they say is refused with ValueError, or has names that can be shown."""
    choices = Choices(data)
    if choices.below(2):
        _peer(choices)
    else:
        _announcement(choices)


def seeds() -> Iterator[bytes]:
    """Announcements of both sizes of an id, and a peer."""
    nodes = (NodeEntities("/", "talker", (bytes(16),), (b"\1" * 16,)), NodeEntities("/robot1", "listener"))
    yield b"\0\0" + encode_announcement(TypeStore.bundled("jazzy"), b"\2" * 16, nodes)
    yield b"\0\1" + encode_announcement(TypeStore.bundled("humble"), b"\2" * 16, nodes)
    hashed = b"typehash=RIHS01_" + b"1" * 64 + b";"
    yield b"\1" + b"\xff".join(
        (b"rt/chatter", b"std_msgs::msg::dds_::String_", b"/talker", hashed, b"\1\1why", b"\0")
    )
