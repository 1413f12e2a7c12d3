"""What ``rmw_zenoh_cpp`` writes into keys, liveliness tokens and attachments: names, settings, stamps.

The conventions are those of its ``docs/design.md`` and ``liveliness_utils``.

Quality of service is ``reliability:durability:history,depth:deadline:lifespan:liveliness``, where the
last three are ``seconds,nanoseconds`` (liveliness: ``kind,seconds,nanoseconds``). Numbers are
those of ``rmw/types.h``; what equals rmw_zenoh's default is left empty. Early releases wrote
the first three parts only, with every number.

An attachment has 33 bytes in Zenoh's serialization format: ``int64`` sequence, ``int64`` nanoseconds since
1970, the length 16, and 16 bytes of id, all little-endian.
"""

from __future__ import annotations

import re
import struct
from typing import NamedTuple

from rosplc.ros.qos import Durability, Qos, Reliability

__all__ = [
    "GID_SIZE",
    "NO_TYPE_HASH",
    "Attachment",
    "dds_type_name",
    "decode_qos",
    "demangle",
    "encode_qos",
    "mangle",
    "pack",
    "ros_type_name",
    "topic_key",
    "unpack",
]

NO_TYPE_HASH = "TypeHashNotSupported"
"""Stands for the type hash on Humble, which has none."""

_DDS_TYPE = re.compile(r"(\w+)::(\w+)::dds_::(\w+)_\Z", re.ASCII)


def dds_type_name(name: str) -> str:
    """Return ``std_msgs::msg::dds_::String_`` for ``std_msgs/msg/String``."""
    package, kind, base = name.split("/")
    return f"{package}::{kind}::dds_::{base}_"


def ros_type_name(name: str) -> str:
    """Undo :func:`dds_type_name`; other names are returned as they are."""
    found = _DDS_TYPE.match(name)
    return "/".join(found.groups()) if found else name


def topic_key(domain: int, topic: str, type_name: str, type_hash: str) -> str:
    """Return the key that a topic's messages are put on.

    Args:
        domain: The ROS domain.
        topic: The absolute topic name.
        type_name: The ROS type name.
        type_hash: The type hash, or :data:`NO_TYPE_HASH`.
    """
    return f"{domain}/{topic.strip('/')}/{dds_type_name(type_name)}/{type_hash}"


def mangle(name: str) -> str:
    """Return a name as one chunk of a key: ``/`` becomes ``%``, which no ROS name has."""
    return name.replace("/", "%")


def demangle(chunk: str) -> str:
    """Undo :func:`mangle`."""
    return chunk.replace("%", "/")


_BEST_EFFORT = "2"
_TRANSIENT_LOCAL = "1"
_KINDS = frozenset({"", "0", "1", "2", "3", "4", "5"})  # of rmw's enumerations; empty is the default
_DEPTH = 42  # rmw_zenoh's default, which is not ROS's
_LONGEST = 2**31 - 1
_UNBOUNDED = ":,:,:,,"  # no deadline, no lifespan, automatic liveliness without a lease


def encode_qos(qos: Qos) -> str:
    """Return the settings as a token carries them."""
    reliability = "" if qos.reliability == "reliable" else _BEST_EFFORT
    durability = "" if qos.durability == "volatile" else _TRANSIENT_LOCAL
    depth = "" if qos.depth == _DEPTH else qos.depth
    return f"{reliability}:{durability}:,{depth}{_UNBOUNDED}"


def decode_qos(text: str) -> Qos:
    """Read the settings of a token, of the short form or the long one.

    Raises:
        ValueError: It is neither.
    """
    parts = text.split(":")
    if len(parts) < 3:
        raise ValueError("the QoS has fewer than three parts")
    history, comma, depth = parts[2].partition(",")
    if not comma or not {parts[0], parts[1], history} <= _KINDS:
        raise ValueError("the QoS has kinds that ROS does not know")
    numbers = [depth, *(number for part in parts[3:6] for number in part.split(","))]
    if not all(number == "" or (number.isascii() and number.isdigit()) for number in numbers):
        raise ValueError("the QoS has something else than numbers")
    reliability: Reliability = "best_effort" if parts[0] == _BEST_EFFORT else "reliable"
    durability: Durability = "transient_local" if parts[1] == _TRANSIENT_LOCAL else "volatile"
    return Qos(reliability, durability, max(1, min(int(depth[:20] or _DEPTH), _LONGEST)))


GID_SIZE = 16

_FORMAT = struct.Struct(f"<qqB{GID_SIZE}s")


class Attachment(NamedTuple):
    """The attachment of one message.

    Attributes:
        sequence: Counts the publisher's messages, from 1.
        stamp_ns: When it was sent (ns since 1970, the sender's clock).
        gid: The publisher's id.
    """

    sequence: int
    stamp_ns: int
    gid: bytes


def pack(sequence: int, stamp_ns: int, gid: bytes) -> bytes:
    """Return the attachment's bytes."""
    return _FORMAT.pack(sequence, stamp_ns, GID_SIZE, gid)


def unpack(data: bytes) -> Attachment:
    """Read an attachment.

    Raises:
        ValueError: It is none, or its numbers make no sense.
    """
    if len(data) < _FORMAT.size:
        raise ValueError(f"the attachment has {len(data)} bytes, not {_FORMAT.size}")
    sequence, stamp_ns, size, gid = _FORMAT.unpack_from(data)
    if size != GID_SIZE:
        raise ValueError(f"the sender's id has {size} bytes, not {GID_SIZE}")
    if sequence < 0 or stamp_ns < 0:
        raise ValueError("sequence number or stamp is negative")
    return Attachment(sequence, stamp_ns, gid)
