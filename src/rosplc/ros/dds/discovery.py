"""Who belongs to which node: the messages on ``ros_discovery_info``.

DDS knows participants, not nodes; every ROS 2 process says on this topic which of its
endpoints belong to which node (``rmw_dds_common/msg/ParticipantEntitiesInfo``). The bytes are
handled here, and not by the wheel's classes: those take a Python object per byte of a gid,
which would hold up the receive thread in a large graph.
"""

from __future__ import annotations

import struct
from collections.abc import Sequence
from dataclasses import dataclass

from rosplc.harmless import one_line

__all__ = [
    "ANNOUNCEMENT",
    "ANNOUNCEMENT_TOPIC",
    "LONGEST_NAME",
    "MOST_CLAIMED",
    "NodeEntities",
    "decode_announcement",
    "encode_announcement",
    "gid_size",
]

ANNOUNCEMENT_TOPIC = "ros_discovery_info"
ANNOUNCEMENT = "rmw_dds_common/msg/ParticipantEntitiesInfo"

_HEADER = b"\x00\x01\x00\x00"  # plain CDR, little-endian
MOST_CLAIMED = 1 << 20  # of nodes or gids that a peer may claim; far above any real graph
LONGEST_NAME = 256  # the bound in rmw_dds_common/msg/NodeEntitiesInfo


@dataclass(frozen=True, slots=True)
class NodeEntities:
    """One node of a participant.

    Attributes:
        namespace: Such as ``/`` or ``/robot1``.
        name: The base name.
        readers: The 16-byte ids of its subscriptions' DDS readers.
        writers: The 16-byte ids of its publishers' DDS writers.
    """

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
    """Return the participant's 16-byte id and its nodes.

    Raises:
        ValueError: If the bytes are no such message.
    """
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
