"""Connections between nodes: headers, read within limits and compared, and the topics of our node.

http://wiki.ros.org/ROS/Connection%20Header
"""

from __future__ import annotations

import contextlib
import itertools
import socket
import threading
from collections.abc import Mapping
from typing import Any, NamedTuple

from rosplc.clock import SYSTEM, Clock
from rosplc.ros.rospy.master import Master

ANY = "*"  # Stands for any type and any checksum.

# Bytes of a connection header, which holds the definition with all types that it needs.
MOST_HEADER = 4 << 20

TIMEOUT_S = 5.0

_ids = itertools.count(1)


class HandshakeError(Exception):
    """The other side's header is missing, too long or invalid; or its stream of messages is out of step."""


def prepare(sock: socket.socket) -> socket.socket:
    """Configure a connection as rospy does: the loss of a peer's machine is detected after 150 s."""
    sock.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
    sock.setsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE, 1)
    sock.setsockopt(socket.IPPROTO_TCP, socket.TCP_KEEPCNT, 9)
    sock.setsockopt(socket.IPPROTO_TCP, socket.TCP_KEEPIDLE, 60)
    sock.setsockopt(socket.IPPROTO_TCP, socket.TCP_KEEPINTVL, 10)
    return sock


def connect(
    place: tuple[str, int], fields: Mapping[str, str], clock: Clock = SYSTEM
) -> tuple[socket.socket, dict[str, str]]:
    """Connect, exchange headers; return connection and peer's header. Raises OSError, HandshakeError."""
    sock = socket.create_connection(place, TIMEOUT_S)
    try:
        prepare(sock).sendall(encode_header(fields))
        return sock, read_header(sock, TIMEOUT_S, clock)
    except BaseException:
        sock.close()
        raise


def connection_info(sock: socket.socket, peer: str, direction: str, topic: str) -> list[list[Any]]:
    """Return what ``rosnode info`` prints about a connection, if any, in rospy's text format."""
    with contextlib.suppress(OSError):  # it ends at this moment
        port, (host, other) = sock.getsockname()[1], sock.getpeername()[:2]
        text = f"TCPROS connection on port {port} to [{host}:{other} on socket {sock.fileno()}]"
        return [[next(_ids), peer, direction, "TCPROS", topic, True, text]]
    return []


def encode_header(fields: Mapping[str, str]) -> bytes:
    """Return the bytes of a header."""
    parts = [f"{name}={value}".encode() for name, value in fields.items()]
    body = b"".join(len(part).to_bytes(4, "little") + part for part in parts)
    return len(body).to_bytes(4, "little") + body


def read_header(sock: socket.socket, timeout_s: float, clock: Clock = SYSTEM) -> dict[str, str]:
    """Read one header and nothing beyond it. Raises OSError; HandshakeError if none arrived in time."""
    deadline_ns = clock.monotonic_ns() + round(timeout_s * 1e9)
    length = int.from_bytes(_exactly(sock, 4, deadline_ns, clock), "little")
    if length > MOST_HEADER:
        raise HandshakeError(f"its connection header announces {length} bytes; the limit is {MOST_HEADER}")
    body = _exactly(sock, length, deadline_ns, clock)
    fields, at = {}, 0
    while at < length:
        end = at + 4 + int.from_bytes(body[at : at + 4], "little")
        name, equals, value = body[at + 4 : end].partition(b"=")
        if end > length or not equals:
            raise HandshakeError("its connection header cannot be read: a field is truncated or has no =")
        try:
            fields[name.decode()] = value.decode()
        except UnicodeDecodeError as error:
            raise HandshakeError(f"its connection header cannot be read: {error}") from error
        at = end
    return fields


def _exactly(sock: socket.socket, length: int, deadline_ns: int, clock: Clock) -> bytes:
    data = bytearray()
    while len(data) < length:
        left = deadline_ns - clock.monotonic_ns()
        if left <= 0:
            raise HandshakeError("its connection header did not arrive in time")
        sock.settimeout(left / 1e9)
        try:
            part = sock.recv(min(65536, length - len(data)))
        except TimeoutError:
            continue
        if not part:
            raise HandshakeError("it closed the connection before its header had arrived")
        data += part
    return bytes(data)


def ros1_name(name: str) -> str:
    """Return ``package/Name`` for ``package/msg/Name`` and ``package/srv/Name``."""
    return name.replace("/msg/", "/", 1).replace("/srv/", "/", 1)


def ros2_name(name: str) -> str:
    """Return ``package/msg/Name`` for ``package/Name``; other texts as they are."""
    package, slash, base = name.partition("/")
    return f"{package}/msg/{base}" if slash and "/" not in base else name


def service_name(name: str) -> str:
    """Return ``package/srv/Name`` for ``package/Name``; other texts as they are."""
    return ros2_name(name).replace("/msg/", "/srv/", 1)


def peer_type(fields: Mapping[str, str]) -> tuple[str, str]:
    """Return type (``package/msg/Name``) and MD5 sum of a header; ``*`` where it has none."""
    return ros2_name(fields.get("type") or ANY)[:256], (fields.get("md5sum") or ANY)[:64]


def mismatch(
    node: str, verb: str, topic: str, theirs: tuple[str, str], ours: tuple[str, str]
) -> tuple[str, str] | None:
    """Return an error code and text if a peer's type name and MD5 sum (``*``: any) differ from ours, or None.

    ``verb`` is ``publishes``, ``subscribes to`` or ``serves``.
    """
    (name, md5), (own_name, own_md5) = theirs, ours
    does = f"node {node} {verb} {topic} as {name}"
    if name not in (ANY, own_name):
        return "ROS003", f"{does}, but the local type is {own_name}"
    if md5 not in (ANY, own_md5):
        does = does if name != ANY else f"node {node} {verb} {topic}"
        return "ROS003", f"{does} with another definition (md5 {md5}, locally {own_md5})"
    return None


class Definition(NamedTuple):
    """A type: its name ``package/msg/Name``, MD5 sum, and definition including all types that it uses."""

    type_name: str
    md5: str
    text: str

    @property
    def identity(self) -> tuple[str, str]:
        """Name and MD5 sum."""
        return self.type_name, self.md5

    def fields(self) -> dict[str, str]:
        """Return the fields of a connection header."""
        return {"type": ros1_name(self.type_name), "md5sum": self.md5, "message_definition": self.text}


class Topic:
    """A topic that the node receives or sends; its subscriptions or publishers share the connections."""

    direction: str
    role: str  # in the names of the master's methods

    def __init__(self, node: Any, topic: str, definition: Definition) -> None:
        self.node, self.topic, self.definition = node, topic, definition
        self.handles: tuple[Any, ...] = ()
        self._lock = threading.Lock()
        self._closed = False

    def add(self, handle: Any) -> None:
        """Add a subscription or publisher."""
        with self._lock:
            self.handles += (handle,)

    def unregister(self, master: Master) -> None:
        """Unregister the topic from the master."""
        master.call(f"unregister{self.role}", self.topic, self.node.uri)

    def register(self, master: Master) -> Any:
        """Register the topic with the master; return the master's response."""
        name = ros1_name(self.definition.type_name)
        return master.call(f"register{self.role}", self.topic, name, self.node.uri)

    def remove(self, handle: Any) -> None:
        """Remove a subscription or publisher."""
        with self._lock:
            self.handles = tuple(one for one in self.handles if one is not handle)
