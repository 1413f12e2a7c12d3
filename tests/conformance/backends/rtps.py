"""Puts any bytes into a DDS reader, in the name of a writer that it has matched.

Every DDS library looks at what is written through it. So the writer is a real one, which writes
nothing itself, and its messages are made here, straight from the DDSI-RTPS specification (2.5,
chapter 8.3.7 and 9.4): a reader asks who a message says it is from, not which socket it came from.
"""

from __future__ import annotations

import socket
import struct

__all__ = ["Impostor"]

_HEADER = struct.Struct("<4sBBH12s")  # "RTPS", version 2.1, vendor, the participant's prefix
_SUBMESSAGE = struct.Struct("<BBH")  # id, flags, bytes that follow
_DATA, _HEARTBEAT = 0x15, 0x07
_LITTLE_ENDIAN, _FINAL, _WITH_PAYLOAD = 0x01, 0x02, 0x04
_ANY_READER = bytes(4)
_COUNT = 1 << 20  # heartbeats are counted, and the writer's own library has sent some
_PARTICIPANTS = 33  # as many per domain as the libraries look for on one machine


class Impostor:
    """Sends as a writer on this machine's loopback interface.

    Args:
        domain: The DDS domain; it gives the ports of its participants (9.6.1.4).
        guid: The 16 bytes of the writer's id.
    """

    def __init__(self, domain: int, guid: bytes) -> None:
        self._guid = guid
        self._sequence = 0
        self._ports = [7400 + 250 * domain + 11 + 2 * number for number in range(_PARTICIPANTS)]

    def send(self, payload: bytes) -> None:
        """Send one message, reliably as far as the reader can tell: no earlier one can be asked for."""
        self._sequence += 1
        number = struct.pack("<iI", 0, self._sequence)
        ends = _ANY_READER + self._guid[12:]
        data = struct.pack("<HH", 0, 16) + ends + number + payload
        # From this message on, to this message: whoever has missed one need not wait for it.
        heartbeat = ends + 2 * number + struct.pack("<i", _COUNT + self._sequence)
        message = _HEADER.pack(b"RTPS", 2, 1, 0x1001, self._guid[:12])
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender:
            for port in self._ports:
                # On their own: a reader that finds one submessage malformed looks at no further one.
                for submessage in (
                    _submessage(_DATA, _WITH_PAYLOAD, data),
                    _submessage(_HEARTBEAT, _FINAL, heartbeat),
                ):
                    sender.sendto(message + submessage, ("127.0.0.1", port))


def _submessage(kind: int, flags: int, body: bytes) -> bytes:
    body += bytes(-len(body) % 4)
    return _SUBMESSAGE.pack(kind, flags | _LITTLE_ENDIAN, len(body)) + body
