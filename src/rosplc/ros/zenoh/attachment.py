"""What ``rmw_zenoh_cpp`` attaches to every message: sequence number, source stamp, sender's id.

33 bytes in Zenoh's serialization format: ``int64`` sequence, ``int64`` nanoseconds since 1970,
the length 16, and 16 bytes of id, all little-endian.
"""

from __future__ import annotations

import struct
from typing import NamedTuple

__all__ = ["GID_SIZE", "Attachment", "pack", "unpack"]

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
