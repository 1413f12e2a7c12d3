"""A topic that is received: one connection and one thread for each publisher, as ROS 1 has it.

All subscriptions of the node to one topic share the connections: a publisher knows a subscriber by
its node's name and keeps one connection for each.
"""

from __future__ import annotations

import logging
import socket
import threading
from collections.abc import Callable
from typing import Any

from rosplc.clock import SYSTEM, Clock
from rosplc.ros._base import BaseSubscription
from rosplc.ros.backend import OnMessage, Qos
from rosplc.ros.rospy.debian import AnyMsg, TCPROSTransport, TransportError, TransportProtocol
from rosplc.ros.rospy.handshake import (
    ANY,
    HandshakeError,
    connect,
    mismatch,
    peer_type,
    read_header,
    ros1_name,
    write_header,
)
from rosplc.ros.rospy.master import RefusedError, UnreachableError, call, proxy

__all__ = [
    "LARGEST_MESSAGE",
    "Incoming",
    "Link",
    "RospySubscription",
    "WireType",
    "handshake",
    "raw_class",
    "request",
]

_logger = logging.getLogger("rosplc.ros.rospy")

_TIMEOUT_S = 5.0
_RETRY_NS = 1_000_000_000  # after a lost connection; doubled with each attempt that fails
_SLOWEST_NS = 8_000_000_000
_REFUSED_NS = 60_000_000_000  # a publisher with another type logs each attempt
LARGEST_MESSAGE = 1 << 30  # a length beyond this is no message but a stream out of step
_READ = 65536


def raw_class(type_name: str, md5: str, text: str) -> type[Any]:
    """Return a message class of rospy for a type that carries bytes as they are."""
    members = {"_type": ros1_name(type_name), "_md5sum": md5, "_full_text": text, "__slots__": ()}
    kind: type[Any] = type("Raw_" + type_name.replace("/", "_"), (AnyMsg,), members)
    return kind


def request(uri: str, caller: str, topic: str) -> tuple[str, int]:
    """Ask a publisher's node where its bytes are to be had; return host and port.

    Raises:
        UnreachableError: The node does not answer.
        RefusedError: It does not publish the topic.
    """
    server = proxy(uri, _TIMEOUT_S)
    try:
        answer = call(server, "requestTopic", caller, topic, [["TCPROS"]])
    finally:
        server("close")()
    if isinstance(answer, list) and len(answer) == 3 and answer[0] == "TCPROS":
        host, port = answer[1:]
        if isinstance(host, str) and isinstance(port, int) and 0 < port < 65536:
            return host, port
    raise UnreachableError(f"its answer is none of ROS: {str(answer)[:200]}")


class WireType:
    """The header fields of a subscriber that takes whatever a topic carries."""

    _type = _md5sum = ANY
    _full_text = ""


def handshake(
    place: tuple[str, int], caller: str, topic: str, kind: type[Any]
) -> tuple[socket.socket, dict[str, str]]:
    """Connect to a publisher as a subscriber; return the connection and the publisher's header.

    Raises:
        OSError: No connection.
        HandshakeError: No valid header.
    """
    sock = connect(*place, _TIMEOUT_S)
    try:
        fields = {
            "callerid": caller,
            "topic": topic,
            "type": kind._type,
            "md5sum": kind._md5sum,
            "message_definition": kind._full_text,
            "tcp_nodelay": "1",
        }
        write_header(sock, fields)
        header = read_header(sock, _TIMEOUT_S)
    except BaseException:
        sock.close()
        raise
    return sock, header


class _Protocol(TransportProtocol):  # type: ignore[misc]
    """Cuts the stream of bytes into messages; the oldest give way to a queue's ``depth``."""

    def __init__(self, incoming: Incoming) -> None:
        super().__init__(incoming.topic, incoming.kind, buff_size=_READ)
        self.direction = "i"
        self.incoming = incoming

    def read_messages(self, b: Any, msg_queue: list[Any], sock: Any) -> None:
        """Move whole messages from the buffer to the queue."""
        end, position = b.tell(), 0
        with b.getbuffer() as view:
            while end - position >= 4:
                length = int.from_bytes(view[position : position + 4], "little")
                if length > LARGEST_MESSAGE:
                    raise TransportError(f"a message of {length} bytes is announced")
                if end - position - 4 < length:
                    break
                position += 4 + length
                msg_queue.append(
                    self.recv_data_class().deserialize(bytes(view[position - length : position]))
                )
            rest = bytes(view[position:end]) if position else b""
        if position:
            b.seek(0)
            b.truncate()
            b.write(rest)


class Link:
    """The connection to one publisher, and the thread that reads from it.

    Args:
        incoming: The topic.
        uri: The publisher's node.

    Attributes:
        node: The publisher's name, once its header has said it.
        connected: Whether messages flow.
        latching: Whether the publisher latches.
        problem: Code and words for what keeps it from connecting, or from being the right type.
        ended: Whether its thread has ended.
    """

    def __init__(self, incoming: Incoming, uri: str) -> None:
        self.uri = uri
        self.node = ""
        self.connected = False
        self.latching = False
        self.problem: tuple[str, str] | None = None
        self.ended = False
        self.retry_ns = 0
        self.pause_ns = _RETRY_NS
        self._incoming = incoming
        self._transport: Any = None
        self._closing = False
        self._thread = threading.Thread(target=self._run, name=f"rosplc-{incoming.topic}", daemon=True)

    def start(self) -> None:
        """Begin to connect."""
        self._thread.start()

    def close(self) -> None:
        """Disconnect; the thread ends soon."""
        self._closing = True
        if (transport := self._transport) is not None:
            transport.close()

    def join(self) -> None:
        """Wait a moment for the thread, unless this is it."""
        if self._thread.is_alive() and threading.current_thread() is not self._thread:
            self._thread.join(1.0)

    def info(self) -> list[Any]:
        """Return what ``rosnode info`` prints of a connection."""
        transport = self._transport
        text = transport.get_transport_info()
        return [transport.id, self.uri, "i", "TCPROS", self._incoming.topic, True, text]

    def _run(self) -> None:
        incoming = self._incoming
        try:
            with incoming.connecting:
                if self._closing:
                    return
                place = request(self.uri, incoming.caller, incoming.topic)
                sock, header = handshake(place, incoming.caller, incoming.topic, incoming.kind)
            self._adopt(sock, header, place)
            if self.connected:
                self._receive()
        except RefusedError as error:
            self.problem = None
            # It has withdrawn the topic, and the master's list has not followed yet.
            _logger.debug("%s: %s: %s", incoming.topic, self.uri, error)
        except (OSError, UnreachableError, HandshakeError) as error:
            text = f"{getattr(error, 'strerror', None) or error}"
            self.problem = ("", f"the node at {self.uri} publishes {incoming.topic}, but {text}")
        except Exception as error:
            if not self._closing:
                _logger.exception("%s: the connection to %s had an error", incoming.topic, self.uri)
                self.problem = ("", f"the connection to {self.uri} had an error: {error}")
        finally:
            self.connected = False
            if self._transport is not None:
                self._transport.close()
            self.ended = True
            self.retry_ns = incoming.clock.monotonic_ns() + self._pause()
            incoming.changed()

    def _pause(self) -> int:
        return _REFUSED_NS if self.problem is not None and self.problem[0] else self.pause_ns

    def _adopt(self, sock: socket.socket, header: dict[str, str], place: tuple[str, int]) -> None:
        incoming = self._incoming
        if "error" in header:
            sock.close()
            self._explain(place, header["error"])
            return
        self.node = header.get("callerid", self.uri)[:256]
        wrong = mismatch(self.node, "publishes", incoming.topic, peer_type(header), incoming.identity)
        if wrong is not None:
            sock.close()
            self.problem = wrong
            return
        transport = TCPROSTransport(_Protocol(incoming), incoming.topic)
        transport.set_socket(sock, self.uri)
        transport.remote_endpoint = place
        transport.header = header
        transport.callerid_pub = self.node
        self.latching = header.get("latching") == "1"
        self._transport = transport
        self.problem = None
        self.pause_ns = _RETRY_NS
        self.connected = not self._closing
        incoming.changed()

    def _explain(self, place: tuple[str, int], refusal: str) -> None:
        """The publisher refused us: ask it, as a subscriber to any type, what it has."""
        incoming = self._incoming
        sock, header = handshake(place, incoming.caller, incoming.topic, WireType)
        sock.close()
        self.node = header.get("callerid", self.uri)[:256]
        self.problem = mismatch(
            self.node, "publishes", incoming.topic, peer_type(header), incoming.identity
        ) or (
            "ROS002",
            f"node {self.node} publishes {incoming.topic}, but refuses this subscriber: {refusal[:300]}",
        )

    def _receive(self) -> None:
        transport, deliver = self._transport, self._incoming.deliver
        try:
            while not transport.done:
                deliver([message._buff for message in transport.receive_once()])
        except (TransportError, AttributeError):
            # The end of the stream; or closed by another thread, which leaves rospy's object empty.
            if not self._closing and not transport.done:
                _logger.debug("%s: %s has closed the connection", self._incoming.topic, self.node)


class Incoming:
    """One topic that the node receives.

    Args:
        caller: The full name of the node.
        topic: The topic.
        type_name: Its type, ``package/msg/Name``.
        md5: The type's MD5 sum.
        text: The type's definition.
        turn: Held while a message is handed over: one call at a time in the whole backend.
        connecting: Bounds how many connections are being made at once.
        changed: Called when a connection comes or goes.
        clock: Time.
    """

    direction = "in"

    def __init__(
        self,
        caller: str,
        topic: str,
        type_name: str,
        md5: str,
        text: str,
        turn: threading.RLock,
        connecting: threading.Semaphore,
        changed: Callable[[], None],
        clock: Clock = SYSTEM,
    ) -> None:
        self.clock = clock
        self.caller = caller
        self.topic = topic
        self.type_name = type_name
        self.identity = (type_name, md5)
        self.kind = raw_class(type_name, md5, text)
        self.connecting = connecting
        self.changed = changed
        self.publishers: tuple[str, ...] = ()
        self._turn = turn
        self._lock = threading.Lock()
        self._links: dict[str, Link] = {}
        self._closed = False
        self.subscriptions: tuple[RospySubscription, ...] = ()

    def links(self) -> tuple[Link, ...]:
        """Return the connections, made or being made."""
        with self._lock:
            return tuple(self._links.values())

    def matched(self) -> int:
        """Return how many publishers are connected."""
        return sum(link.connected for link in self.links())

    def update(self) -> None:
        """Connect to every publisher that the master names, and leave those that it no longer names."""
        now = self.clock.monotonic_ns()
        named = dict.fromkeys(self.publishers)
        with self._lock:
            gone = [link for uri, link in self._links.items() if uri not in named and not link.connected]
            # A connection that works outlives its registration: masters come and go.
            for link in gone:
                del self._links[link.uri]
            new = []
            for uri in named if not self._closed else ():
                former = self._links.get(uri)
                if former is None or (former.ended and now >= former.retry_ns):
                    new.append(Link(self, uri))
                    if former is not None:
                        new[-1].problem = former.problem  # until it is known anew
                        new[-1].pause_ns = min(2 * former.pause_ns, _SLOWEST_NS)
                    self._links[uri] = new[-1]
        for link in gone:
            link.close()
        for link in new:
            link.start()

    def deliver(self, batch: list[bytes]) -> None:
        """Hand messages to the subscriptions; called by the connections' threads."""
        stamp_ns = self.clock.time_ns()
        with self._turn:
            for subscription in self.subscriptions:
                subscription.receive(batch, stamp_ns)

    def add(self, subscription: RospySubscription) -> None:
        """Hand messages to one more subscription; it gets no message that came before."""
        with self._turn:
            self.subscriptions += (subscription,)

    def remove(self, subscription: RospySubscription) -> int:
        """Hand messages to it no longer; return how many subscriptions are left."""
        with self._turn:
            self.subscriptions = tuple(s for s in self.subscriptions if s is not subscription)
            return len(self.subscriptions)

    def close(self) -> tuple[Link, ...]:
        """Disconnect; return the connections, whose threads are about to end."""
        with self._lock:
            self._closed = True
            links = tuple(self._links.values())
            self._links.clear()
        for link in links:
            link.close()
        return links


class RospySubscription(BaseSubscription):
    """A topic that is being received; see :class:`rosplc.ros.backend.Subscription`."""

    logger = _logger

    def __init__(
        self,
        incoming: Incoming,
        qos: Qos,
        on_message: OnMessage,
        diagnose: Callable[[Incoming], tuple[str, str]],
        forget: Callable[[RospySubscription], None],
        clock: Clock = SYSTEM,
    ) -> None:
        super().__init__(incoming.topic, incoming.type_name, qos, forget, clock)
        self.incoming = incoming
        self._on_message = on_message
        self._diagnose = diagnose

    def _matched(self) -> int:
        return self.incoming.matched()

    def _problem(self) -> tuple[str, str]:
        return self._diagnose(self.incoming)

    def receive(self, batch: list[bytes], stamp_ns: int) -> None:
        """Take messages that arrived together; the backend's turn is held."""
        late = len(batch) - self.qos.depth
        if late > 0:
            self._dropped += late
            batch = batch[late:]
        for payload in batch:
            if self.closed:
                return
            self._deliver(payload, stamp_ns)
