"""Connection headers (http://wiki.ros.org/ROS/Connection%20Header), read with bounds, and compared.

rospy's own reader believes the announced length, up to 4 GiB, and waits for it without end.
"""

from __future__ import annotations

import socket
import time
from collections.abc import Mapping

from rosplc.ros.rospy.debian import decode_header, encode_header

__all__ = [
    "ANY",
    "MOST_HEADER",
    "HandshakeError",
    "connect",
    "mismatch",
    "peer_type",
    "read_header",
    "ros1_name",
    "ros2_name",
    "write_header",
]

ANY = "*"
"""Stands for any type and any checksum."""

MOST_HEADER = 4 << 20
"""Bytes of a connection header, which holds the definition with all types that it needs."""


class HandshakeError(Exception):
    """The other side's header is missing, too long or no header."""


def connect(host: str, port: int, timeout_s: float) -> socket.socket:
    """Connect to a node's TCPROS port; OSError if that fails."""
    sock = socket.create_connection((host, port), timeout_s)
    try:
        sock.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        # As rospy sets it: a peer whose machine has lost its power is missed after 150 s.
        sock.setsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE, 1)
        sock.setsockopt(socket.IPPROTO_TCP, socket.TCP_KEEPCNT, 9)
        sock.setsockopt(socket.IPPROTO_TCP, socket.TCP_KEEPIDLE, 60)
        sock.setsockopt(socket.IPPROTO_TCP, socket.TCP_KEEPINTVL, 10)
    except OSError:
        sock.close()
        raise
    return sock


def write_header(sock: socket.socket, fields: Mapping[str, str]) -> None:
    """Send a header; OSError if that fails."""
    sock.sendall(encode_header(dict(fields)))


def read_header(sock: socket.socket, timeout_s: float) -> dict[str, str]:
    """Read one header and nothing behind it.

    Raises:
        HandshakeError: No valid header came within the time.
        OSError: The connection failed.
    """
    deadline = time.monotonic() + timeout_s
    start = _exactly(sock, 4, deadline)
    length = int.from_bytes(start, "little")
    if length > MOST_HEADER:
        raise HandshakeError(f"its connection header announces {length} bytes, {MOST_HEADER} are the most")
    rest = _exactly(sock, length, deadline)
    try:
        fields: dict[str, str] = decode_header(start + rest)
    except Exception as error:  # rospy's exception, or what damaged bytes make of struct and decode
        raise HandshakeError(f"its connection header cannot be read: {error}") from error
    return fields


def _exactly(sock: socket.socket, length: int, deadline: float) -> bytes:
    data = bytearray()
    while len(data) < length:
        left = deadline - time.monotonic()
        if left <= 0:
            raise HandshakeError("its connection header did not arrive in time")
        sock.settimeout(left)
        try:
            part = sock.recv(min(65536, length - len(data)))
        except TimeoutError:
            continue
        if not part:
            raise HandshakeError("it closed the connection before its header had arrived")
        data += part
    return bytes(data)


def ros1_name(name: str) -> str:
    """Return ``package/Name`` for ``package/msg/Name``."""
    return name.replace("/msg/", "/", 1)


def ros2_name(name: str) -> str:
    """Return ``package/msg/Name`` for ``package/Name``; other texts as they are."""
    package, slash, base = name.partition("/")
    return f"{package}/msg/{base}" if slash and "/" not in base else name


def peer_type(fields: Mapping[str, str]) -> tuple[str, str]:
    """Return type (``package/msg/Name``) and MD5 sum of a header; ``*`` where it does not say."""
    return ros2_name(fields.get("type") or ANY)[:256], (fields.get("md5sum") or ANY)[:64]


def mismatch(
    node: str, verb: str, topic: str, theirs: tuple[str, str], ours: tuple[str, str]
) -> tuple[str, str] | None:
    """Return code and words if two types are not the same; None if they are.

    Args:
        node: The peer's full name.
        verb: ``publishes`` or ``subscribes to``.
        topic: The topic.
        theirs: The peer's type name and MD5 sum; ``*`` stands for any.
        ours: Ours.
    """
    (name, md5), (own_name, own_md5) = theirs, ours
    does = f"node {node} {verb} {topic} as {name}"
    if name not in (ANY, own_name):
        return "ROS003", f"{does}, here it is {own_name}"
    if md5 not in (ANY, own_md5):
        does = does if name != ANY else f"node {node} {verb} {topic}"
        return "ROS003", f"{does} with another definition (md5 {md5} there, {own_md5} here)"
    return None
