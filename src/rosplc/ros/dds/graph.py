"""Our node in the ROS graph, and the other nodes in it: the messages on ``ros_discovery_info``.

DDS knows participants, not nodes; every ROS 2 process announces on this topic which of its endpoints belong
to which node (``rmw_dds_common/msg/ParticipantEntitiesInfo``). The bytes are handled here, and not by the
wheel's classes: those take a Python object per byte of a gid, which would hold up the receive thread.
"""

from __future__ import annotations

import logging
import struct
import threading
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from cyclonedds._clayer import ddspy_take, ddspy_write
from cyclonedds.pub import DataWriter
from cyclonedds.sub import DataReader

from rosplc.harmless import one_line
from rosplc.model import TypeStore
from rosplc.ros.backend import Qos
from rosplc.ros.dds import native
from rosplc.ros.dds.idl import IdlTypes

_logger = logging.getLogger("rosplc.ros.dds")

ANNOUNCEMENT_TOPIC = "ros_discovery_info"
ANNOUNCEMENT = "rmw_dds_common/msg/ParticipantEntitiesInfo"

_HEADER = b"\x00\x01\x00\x00"  # plain CDR, little-endian
MOST_CLAIMED = 1 << 20  # of nodes or gids that a peer may claim; far above any real graph
LONGEST_NAME = 256  # the bound in rmw_dds_common/msg/NodeEntitiesInfo


@dataclass(frozen=True, slots=True)
class NodeEntities:
    """One node of a participant: its names, and the 16-byte ids of its endpoints' DDS readers and writers."""

    namespace: str
    name: str
    readers: tuple[bytes, ...] = ()
    writers: tuple[bytes, ...] = ()

    @property
    def full_name(self) -> str:
        """``/robot1/talker``."""
        return one_line(f"/{self.namespace.strip('/')}/{self.name}".replace("//", "/"))


def gid_size(distro: str) -> int:
    """Return the length of ``rmw_dds_common/msg/Gid`` in bytes: 24 up to Humble, 16 since Iron."""
    return 24 if distro == "humble" else 16


def encode_announcement(participant: bytes, nodes: Sequence[NodeEntities], size: int) -> bytes:
    """Return the CDR bytes of a participant's announcement; ``size`` is :func:`gid_size`."""
    out = bytearray(participant.ljust(size, b"\0"))

    def count(number: int) -> None:
        out.extend(bytes(-len(out) % 4) + struct.pack("<I", number))

    def text(value: str) -> None:
        data = value.encode() + b"\0"
        count(len(data))
        out.extend(data)

    count(len(nodes))
    for node in nodes:
        text(node.namespace)
        text(node.name)
        for gids in (node.readers, node.writers):
            count(len(gids))
            for gid in gids:
                out.extend(gid.ljust(size, b"\0"))
    return _HEADER + bytes(out) + bytes(-len(out) % 4)


def decode_announcement(data: bytes, size: int) -> tuple[bytes, tuple[NodeEntities, ...]]:
    """Return the participant's 16-byte id and its nodes; ValueError if the bytes are no such message."""
    if len(data) < 4 or data[0] != 0 or data[1] not in (0, 1):
        raise ValueError("no plain CDR")
    order = "<I" if data[1] else ">I"
    body = memoryview(data)[4:]
    at = 0

    def take(length: int) -> bytes:
        nonlocal at
        if length > len(body) - at:
            raise ValueError("truncated")
        at += length
        return bytes(body[at - length : at])

    def count() -> int:
        take(-at % 4)
        (number,) = struct.unpack(order, take(4))
        if number > MOST_CLAIMED:
            raise ValueError("too long")
        return int(number)

    def text() -> str:
        data = take(count()).rstrip(b"\0")
        if len(data) > LONGEST_NAME:
            raise ValueError("a name is too long")
        return data.decode(errors="replace")

    def gids() -> tuple[bytes, ...]:
        return tuple(take(size)[:16] for _ in range(count()))

    participant = take(size)[:16]
    nodes = tuple(NodeEntities(text(), text(), gids(), gids()) for _ in range(count()))
    return participant, nodes


_QOS = Qos(durability="transient_local", depth=1)
MOST_PARTICIPANTS = 10_000  # anybody may announce in the name of participants that there are not
_READ_QOS = Qos(durability="transient_local", depth=1000)  # one instance for all participants: no keys


# Of ANNOUNCEMENT since Iron; a test computes it.
_HASH = "RIHS01_91a0593bacdcc50ea9bdcf849a938b128412cc1ea821245c663bcd26f83c295e"


def announcement_types(distro: str) -> tuple[TypeStore, str]:
    """Return the announcement's definition, which a store of custom types need not have, and its hash."""
    line = "=" * 80
    text = f"""Gid gid
NodeEntitiesInfo[] node_entities_info_seq
{line}
MSG: rmw_dds_common/Gid
char[{gid_size(distro)}] data
{line}
MSG: rmw_dds_common/NodeEntitiesInfo
string<=256 node_namespace
string<=256 node_name
Gid[] reader_gid_seq
Gid[] writer_gid_seq
"""
    return TypeStore.from_definition(ANNOUNCEMENT, text), "" if distro == "humble" else _HASH


class Announcer:
    """One node's place in the graph; ``qos_of`` makes the wheel's QoS from a :class:`Qos` and a type hash."""

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
        self._guid = guid  # 16 bytes
        self._node = (namespace, name)
        self._size = gid_size(distro)
        self._lock = threading.RLock()
        self._others: dict[bytes, tuple[NodeEntities, ...]] = {}
        self._names: dict[bytes, str] = {}
        types, type_hash = announcement_types(distro)
        topic = topics(ANNOUNCEMENT_TOPIC, IdlTypes(types)[ANNOUNCEMENT])
        self._writer = DataWriter(participant, topic, qos_of(_QOS, type_hash))
        self._reader = DataReader(participant, topic, qos_of(_READ_QOS, type_hash))
        self.reader: int = self._reader._ref
        self.announce({})

    def announce(self, endpoints: Mapping[bytes, bool], *, leaving: bool = False) -> None:
        """Publish the node's endpoints (id → whether it is a reader), or that there is no node any more."""
        readers, writers = (
            tuple(sorted(guid for guid, reads in endpoints.items() if reads is wanted))
            for wanted in (True, False)
        )
        nodes = () if leaving else (NodeEntities(*self._node, readers, writers),)
        code = ddspy_write(self._writer._ref, encode_announcement(self._guid, nodes, self._size))
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
                self.forget(guid)
                if len(self._others) >= MOST_PARTICIPANTS:
                    continue
                self._others[guid] = nodes
                for node in nodes:
                    for gid in node.readers + node.writers:
                        self._names[gid] = node.full_name

    def forget(self, participant: bytes) -> None:
        """Drop what a participant announced that has gone, or announces something else now."""
        with self._lock:
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
        self.announce({}, leaving=True)
        for entity in (self._writer, self._reader):
            native.delete(entity)
