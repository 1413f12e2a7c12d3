"""Our node in the ROS graph, and the other nodes in it.

Announces on ``ros_discovery_info`` which endpoints are ours, so that ``ros2 node list`` and
``ros2 topic info -v`` show them, and listens there for the names of the others.
"""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable
from typing import Any

from cyclonedds._clayer import ddspy_take, ddspy_write
from cyclonedds.pub import DataWriter
from cyclonedds.sub import DataReader

from rosplc.model.types import (
    ArrayType,
    Field,
    MessageType,
    NamedType,
    PrimitiveType,
    SequenceType,
    StringType,
)
from rosplc.ros.backend import Qos
from rosplc.ros.dds import native
from rosplc.ros.dds.discovery import (
    ANNOUNCEMENT,
    ANNOUNCEMENT_TOPIC,
    NodeEntities,
    decode_announcement,
    encode_announcement,
    gid_size,
)
from rosplc.ros.dds.idl import IdlTypes

__all__ = ["MOST_PARTICIPANTS", "AnnouncementTypes", "Announcer"]

_logger = logging.getLogger("rosplc.ros.dds")

_QOS = Qos(durability="transient_local", depth=1)
MOST_PARTICIPANTS = 10_000  # anybody may announce in the name of participants that there are not
_READ_QOS = Qos(durability="transient_local", depth=1000)  # one instance for all participants: no keys


class AnnouncementTypes:
    """The definition of the announcement, which a store of custom types need not have."""

    def __init__(self, distro: str) -> None:
        self.distro = distro
        gid, node = "rmw_dds_common/msg/Gid", "rmw_dds_common/msg/NodeEntitiesInfo"
        gids = SequenceType(NamedType(gid))
        self._types = {
            gid: MessageType(gid, (Field("data", ArrayType(PrimitiveType("char"), gid_size(distro))),)),
            node: MessageType(
                node,
                (
                    Field("node_namespace", StringType(256)),
                    Field("node_name", StringType(256)),
                    Field("reader_gid_seq", gids),
                    Field("writer_gid_seq", gids),
                ),
            ),
            ANNOUNCEMENT: MessageType(
                ANNOUNCEMENT,
                (
                    Field("gid", NamedType(gid)),
                    Field("node_entities_info_seq", SequenceType(NamedType(node))),
                ),
            ),
        }

    def __getitem__(self, name: str) -> MessageType:
        """Return one of the three types."""
        return self._types[name]

    def type_hash(self, name: str) -> str:
        """Return the hash of the announcement; Humble has none."""
        return "" if self.distro == "humble" else _HASH


_HASH = "RIHS01_91a0593bacdcc50ea9bdcf849a938b128412cc1ea821245c663bcd26f83c295e"
"""Of ``rmw_dds_common/msg/ParticipantEntitiesInfo`` since Iron; a test computes it."""


class Announcer:
    """One node's place in the graph.

    Args:
        participant: The wheel's participant.
        topics: Opens its topics.
        guid: Its 16-byte id.
        namespace: The node's namespace.
        name: The node's base name.
        distro: The ROS distribution.
        qos_of: Makes the wheel's QoS from a :class:`Qos` and a type hash.
    """

    def __init__(
        self,
        participant: Any,
        topics: Callable[[str, Any], Any],
        guid: bytes,
        namespace: str,
        name: str,
        distro: str,
        qos_of: Callable[[Qos, str], Any],
    ) -> None:
        self._guid = guid
        self._node = (namespace, name)
        self._size = gid_size(distro)
        self._lock = threading.Lock()
        self._readers: set[bytes] = set()
        self._writers: set[bytes] = set()
        self._others: dict[bytes, tuple[NodeEntities, ...]] = {}
        self._names: dict[bytes, str] = {}
        types = AnnouncementTypes(distro)
        type_hash = types.type_hash(ANNOUNCEMENT)
        topic = topics(ANNOUNCEMENT_TOPIC, IdlTypes(types)[ANNOUNCEMENT])
        self._writer = DataWriter(participant, topic, qos_of(_QOS, type_hash))
        self._reader = DataReader(participant, topic, qos_of(_READ_QOS, type_hash))
        self.reader: int = self._reader._ref
        self.announce()

    def add(self, guid: bytes, *, reader: bool) -> None:
        """Count an endpoint among the node's; :meth:`announce` tells the others."""
        with self._lock:
            (self._readers if reader else self._writers).add(guid)

    def remove(self, guid: bytes) -> None:
        """Take an endpoint off the node's."""
        with self._lock:
            self._readers.discard(guid)
            self._writers.discard(guid)

    def announce(self, *, leaving: bool = False) -> None:
        """Publish the node's endpoints, or that the participant has no node any more."""
        with self._lock:
            node = NodeEntities(*self._node, tuple(sorted(self._readers)), tuple(sorted(self._writers)))
            data = encode_announcement(self._guid, () if leaving else (node,), self._size)
            code = ddspy_write(self._writer._ref, data)
        if code < 0:
            _logger.warning("the node could not be announced: %s", native.refusal("write", code))

    def take(self) -> None:
        """Read the other participants' announcements."""
        samples = ddspy_take(self.reader, native.ANY_STATE, 1024)
        if isinstance(samples, int):
            return
        for data, info in samples:
            if not info.valid_data:
                continue
            try:
                guid, nodes = decode_announcement(data, self._size)
            except ValueError as error:
                _logger.warning("an announcement on %s cannot be read: %s", ANNOUNCEMENT_TOPIC, error)
                continue
            if guid == self._guid:
                continue
            with self._lock:
                self._forget(guid)
                if len(self._others) >= MOST_PARTICIPANTS:
                    continue
                self._others[guid] = nodes
                for node in nodes:
                    for gid in node.readers + node.writers:
                        self._names[gid] = node.full_name

    def forget(self, participant: bytes) -> None:
        """Drop what a participant announced that has gone."""
        with self._lock:
            self._forget(participant)

    def _forget(self, participant: bytes) -> None:
        for node in self._others.pop(participant, ()):
            for gid in node.readers + node.writers:
                self._names.pop(gid, None)

    def node_of(self, endpoint: bytes) -> str:
        """Return the full name of the node that an endpoint belongs to; empty if nobody says."""
        with self._lock:
            return self._names.get(endpoint, "")

    def nodes(self) -> tuple[str, ...]:
        """Return the full names of the other nodes, sorted."""
        with self._lock:
            return tuple(sorted({node.full_name for nodes in self._others.values() for node in nodes}))

    def close(self) -> None:
        """Say that the node has gone, and delete the entities."""
        self.announce(leaving=True)
        for entity in (self._writer, self._reader):
            native.delete(entity)
