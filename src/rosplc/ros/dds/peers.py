"""The other participants' endpoints, and why one of them does not match ours.

DDS says nothing when a reader and a writer of one topic do not fit each other. Its builtin
topics show every endpoint of the domain, so the reason can be found by comparison: another
type name, another type hash (ROS announces it in the endpoint's user data), settings that
exclude each other, and what is left is another definition of the type.
"""

from __future__ import annotations

import re
import threading
from dataclasses import dataclass
from typing import Any

from cyclonedds._clayer import ddspy_take_endpoint, ddspy_take_participant
from cyclonedds.builtin import (
    BuiltinDataReader,
    BuiltinTopicDcpsParticipant,
    BuiltinTopicDcpsPublication,
    BuiltinTopicDcpsSubscription,
)
from cyclonedds.core import InstanceState

from rosplc.ros.backend import Qos, incompatibility
from rosplc.ros.dds.announced import Announced, read_announced
from rosplc.ros.dds.idl import ros_topic, ros_type_name

__all__ = ["Peer", "PeerTable", "describe", "differs", "explain"]

_TYPE_HASH = re.compile(rb"(?:^|;)typehash=(RIHS01_[0-9a-f]{64});")
_BATCH = 256


@dataclass(frozen=True, slots=True)
class Peer:
    """An endpoint of another participant.

    Attributes:
        guid: Its 16-byte id.
        handle: Its instance handle, by which DDS lists matched peers.
        participant: Its participant's 16-byte id.
        writer: True if it publishes.
        topic: The DDS topic name.
        type_name: The DDS type name.
        qos: Its settings, as far as the bridge has such; the depth is not announced.
        obstacles: Its other settings that keep a plain ROS endpoint from matching, in words.
        type_hash: The ROS type hash it announces, or empty.
    """

    guid: bytes
    handle: int
    participant: bytes
    writer: bool
    topic: str
    type_name: str
    qos: Qos
    obstacles: tuple[str, ...]
    type_hash: str


class PeerTable:
    """What the builtin topics have shown so far; updated by the receive thread.

    Args:
        participant: The wheel's participant.
        own: Its 16-byte id; its own endpoints are left out.
    """

    def __init__(self, participant: Any, own: bytes) -> None:
        self._own = own
        self._lock = threading.Lock()
        self._peers: dict[bytes, Peer] = {}
        self._by_topic: dict[tuple[str, bool], dict[bytes, Peer]] = {}
        self.readers = (
            BuiltinDataReader(participant, BuiltinTopicDcpsPublication),
            BuiltinDataReader(participant, BuiltinTopicDcpsSubscription),
            BuiltinDataReader(participant, BuiltinTopicDcpsParticipant),
        )

    def update(self, which: int) -> set[str]:
        """Take what is new on ``readers[which]``, 0 or 1; return the DDS topics concerned."""
        ref = self.readers[which]._ref
        writer = which == 0
        changed: set[str] = set()

        def see(
            guid: bytes,
            participant: bytes,
            _: int,
            topic: str | None,
            kind: str | None,
            announced: Announced | None,
            info: Any,
            __: Any,
        ) -> None:
            if participant == self._own:
                return
            if not info.valid_data or info.instance_state != InstanceState.Alive:
                changed.update(self._forget(guid))
            elif topic is not None and kind is not None and announced is not None:
                found = _TYPE_HASH.search(announced.user_data)
                peer = Peer(
                    guid,
                    info.instance_handle,
                    participant,
                    writer,
                    topic,
                    kind,
                    announced.qos,
                    announced.obstacles,
                    found.group(1).decode() if found else "",
                )
                with self._lock:
                    self._peers[guid] = peer
                    self._by_topic.setdefault((topic, writer), {})[guid] = peer
                changed.add(topic)

        def settings(pointer: int) -> Announced:
            return read_announced(pointer, writer=writer)

        while True:
            taken = ddspy_take_endpoint(ref, _BATCH, see, settings)
            if isinstance(taken, int) or len(taken) < _BATCH:
                return changed

    def gone(self) -> set[bytes]:
        """Take what is new on ``readers[2]``; return the ids of participants that have left or died."""
        left: set[bytes] = set()

        def see(guid: bytes, _: None, info: Any) -> None:
            if not info.valid_data or info.instance_state != InstanceState.Alive:
                left.add(guid)

        while True:
            taken = ddspy_take_participant(self.readers[2]._ref, _BATCH, see, lambda _: None)
            if isinstance(taken, int) or len(taken) < _BATCH:
                return left

    def _forget(self, guid: bytes) -> set[str]:
        with self._lock:
            peer = self._peers.pop(guid, None)
            if peer is None:
                return set()
            self._by_topic[peer.topic, peer.writer].pop(guid, None)
            return {peer.topic}

    def on(self, topic: str, *, writers: bool) -> tuple[Peer, ...]:
        """Return the endpoints of one kind on a DDS topic."""
        with self._lock:
            return tuple(self._by_topic.get((topic, writers), {}).values())

    def all(self) -> tuple[Peer, ...]:
        """Return all endpoints."""
        with self._lock:
            return tuple(self._peers.values())


def differs(ours: str, theirs: str) -> bool:
    """Return whether two announced type hashes say that the definitions differ; empty says nothing."""
    return bool(ours and theirs and ours != theirs)


def describe(peer: Peer, name: str) -> str:
    """Return what a peer does, such as ``node /talker publishes /chatter as std_msgs/msg/String``."""
    verb = "publishes" if peer.writer else "subscribes to"
    return f"{name} {verb} {ros_topic(peer.topic) or peer.topic} as {ros_type_name(peer.type_name)}"


def explain(
    peer: Peer, name: str, type_name: str, type_hash: str, qos: Qos, matched: bool
) -> tuple[str, str] | None:
    """Return code and words for what is wrong between a peer and one of our endpoints.

    None if nothing is wrong, or if nothing is known that would explain why they do not match.

    Args:
        peer: The peer's endpoint on the same topic, of the other kind.
        name: What to call the peer.
        type_name: Our type, as ROS writes it.
        type_hash: Our type hash; empty if there is none to compare (Humble).
        qos: Our endpoint's settings.
        matched: Whether DDS has matched the two.
    """
    theirs = ros_type_name(peer.type_name)
    does = describe(peer, name)
    if theirs != type_name:
        return "ROS003", f"{does}, here it is {type_name}"
    if differs(type_hash, peer.type_hash):
        here, there = type_hash[7:15], peer.type_hash[7:15]
        return "ROS003", f"{does} with another definition (type hash {there}… there, {here}… here)"
    if matched:
        return None  # by DDS's own judgement nothing else is wrong
    problem = incompatibility(peer.qos, qos) if peer.writer else incompatibility(qos, peer.qos)
    problems = [problem] if problem else []
    problems += peer.obstacles
    if problems:
        return "ROS004", f"{does}, but {'; '.join(problems)}"
    return None
