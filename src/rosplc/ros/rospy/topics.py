"""Topics: one connection per received publisher and per subscriber.

All subscriptions of the node to a topic share the connections: a publisher identifies a subscriber by its
node name and keeps one connection per node. C code (``tcp.c``) transfers the messages: two threads of a
node serve all its connections, and messages that a sink accepts need neither thread.
"""

from __future__ import annotations

import contextlib
import logging
import socket
import threading
from typing import Any, NamedTuple

from rosplc.ros._base import BasePublisher, BaseSubscription, Problem
from rosplc.ros.backend import OnMessage, Qos, Sink
from rosplc.ros.rospy import handshake
from rosplc.ros.rospy._tcp import Loop, Outlet, Sender
from rosplc.ros.rospy.handshake import ANY, Topic
from rosplc.ros.rospy.master import Master, RefusedError, UnreachableError, call, proxy

_logger = logging.getLogger("rosplc.ros.rospy")

_RETRY_NS = 1_000_000_000  # after a lost connection; doubled with each attempt that fails
_SLOWEST_NS = 8_000_000_000
_REFUSED_NS = 60_000_000_000  # a publisher with another type logs each attempt

LARGEST_MESSAGE = 1 << 30  # a length beyond this is no message but a stream out of step

# Of a subscriber that takes whatever a topic carries.
ANY_TYPE = handshake.Definition(handshake.ANY, handshake.ANY, "")


def request(uri: str, caller: str, topic: str) -> tuple[str, int]:
    """Request a topic; return host and port. Raises UnreachableError; RefusedError: not the node's topic."""
    server = proxy(uri, handshake.TIMEOUT_S)
    try:
        answer = call(server, "requestTopic", caller, topic, [["TCPROS"]])
    finally:
        server("close")()
    if isinstance(answer, list) and len(answer) == 3 and answer[0] == "TCPROS":
        host, port = answer[1:]
        if isinstance(host, str) and isinstance(port, int) and 0 < port < 65536:
            return host, port
    raise UnreachableError(f"invalid response: {str(answer)[:200]}")


def greet(
    place: tuple[str, int], caller: str, topic: str, definition: handshake.Definition
) -> tuple[socket.socket, dict[str, str]]:
    """Connect as a subscriber; return the connection and header. Raises OSError, HandshakeError."""
    fields = {"callerid": caller, "topic": topic, "tcp_nodelay": "1", **definition.fields()}
    return handshake.connect(place, fields)


class Connections:
    """The connections of a node in one direction, and the thread that serves them."""

    def __init__(self, name: str) -> None:
        self.loop = Loop(LARGEST_MESSAGE)
        self._closing = False
        self._thread = threading.Thread(target=self._run, name=name, daemon=True)
        self._thread.start()

    def _run(self) -> None:
        while not self._closing:
            for owner, messages, why in self.loop.wait():
                try:
                    if messages:
                        owner.deliver(messages)
                except Exception as error:
                    _logger.exception("error in a connection")
                    why = f"an error occurred: {error}"
                if why is not None:
                    owner.end(why)

    def let_go(self, sock: socket.socket) -> None:
        """Close a connection."""
        self.loop.remove(sock.fileno())
        with contextlib.suppress(OSError):
            sock.shutdown(socket.SHUT_RDWR)
        sock.close()

    def close(self) -> None:
        """End the thread; this is the last call."""
        self._closing = True
        self.loop.wake()
        if threading.current_thread() is not self._thread:
            self._thread.join(1.0)  # a receiver may hang
        self.loop.close()


class Link:
    """The connection to one publisher, and the thread that establishes it."""

    def __init__(self, incoming: Incoming, uri: str, former: Link | None = None) -> None:
        self.uri = uri
        self.node = ""  # the publisher's name, once its header has named it
        self.connected = self.latching = self.ended = False
        # code and words for what keeps it from connecting, or from being the right type
        self.problem: Problem | None = former.problem if former else None  # until it is known again
        self.retry_ns = 0
        self.pause_ns: int = min(2 * former.pause_ns, _SLOWEST_NS) if former else _RETRY_NS
        self._incoming = incoming
        self._sock: socket.socket | None = None
        self._closing = False
        self._thread = threading.Thread(target=self._run, name=f"rosplc-{incoming.topic}", daemon=True)

    def start(self) -> None:
        """Start to connect."""
        try:
            self._thread.start()
        except RuntimeError:  # out of threads
            self.end()

    def close(self) -> None:
        """Disconnect."""
        self._closing = True
        if self.connected:
            self.end()
        elif (sock := self._sock) is not None:  # the thread notices
            with contextlib.suppress(OSError):
                sock.shutdown(socket.SHUT_RDWR)

    def join(self) -> None:
        """Wait briefly for the thread, unless called from it."""
        if self._thread.is_alive() and threading.current_thread() is not self._thread:
            self._thread.join(1.0)

    def info(self) -> list[list[Any]]:
        """Return what ``rosnode info`` prints about the connection, if it exists."""
        if not self.connected or self._sock is None:
            return []
        return handshake.connection_info(self._sock, self.uri, "i", self._incoming.topic)

    def divert(self, capsule: object) -> None:
        """Pass received messages to a sink, or deliver them (None); ``linking`` is held."""
        if self.connected and self._sock is not None:
            self._incoming.node.inbound.loop.divert(self._sock.fileno(), capsule)

    def deliver(self, messages: list[bytes]) -> None:
        """Hand messages to the subscriptions."""
        if not self._closing:
            self._incoming.deliver(messages)

    def end(self, why: str = "") -> None:
        """Close the connection, or note that there is none; a second call does nothing."""
        incoming = self._incoming
        with incoming.linking:
            if self.ended:
                return
            self.ended, self.connected = True, False
            if self._sock is not None:
                incoming.node.inbound.let_go(self._sock)
            pause = _REFUSED_NS if self.problem is not None and self.problem[0] else self.pause_ns
            self.retry_ns = incoming.node.clock.monotonic_ns() + pause
        if why and not self._closing:
            _logger.debug("%s: the connection to %s ended: %s", incoming.topic, self.node, why)
        incoming.node.wake()

    def _run(self) -> None:
        incoming = self._incoming
        topic = incoming.topic
        try:
            with incoming.node.connecting:
                if not self._closing:
                    place = request(self.uri, incoming.node.node, topic)
                    self._sock, header = greet(place, incoming.node.node, topic, incoming.definition)
            if self._sock is not None and self._fits(header, place):
                self.problem = None
                self.pause_ns = _RETRY_NS
                with incoming.linking:
                    if not self._closing:
                        incoming.node.inbound.loop.receive(self._sock.fileno(), self, incoming.capsule)
                        self.connected = True
        except RefusedError as error:
            self.problem = None
            # It has withdrawn the topic, and the master's list has not followed yet.
            _logger.debug("%s: %s: %s", topic, self.uri, error)
        except (OSError, UnreachableError, handshake.HandshakeError) as error:
            text = f"{getattr(error, 'strerror', None) or error}"
            self.problem = ("", f"the node at {self.uri} publishes {topic}, but {text}")
        except Exception as error:
            if not self._closing:
                _logger.exception("%s: the connection to %s failed", topic, self.uri)
                self.problem = ("", f"the connection to {self.uri} failed: {error}")
        if self.connected:
            incoming.node.wake()
        else:
            self.end()

    def _fits(self, header: dict[str, str], place: tuple[str, int]) -> bool:
        incoming = self._incoming
        refusal = header.get("error")
        if refusal is not None:  # ask it, as a subscriber to any type, what it has
            sock, header = greet(place, incoming.node.node, incoming.topic, ANY_TYPE)
            sock.close()
        self.node = header.get("callerid", self.uri)[:256]
        self.latching = header.get("latching") == "1"
        ours = incoming.definition.identity
        wrong = handshake.mismatch(self.node, "publishes", incoming.topic, handshake.peer_type(header), ours)
        if wrong is None and refusal is not None:
            does = f"node {self.node} publishes {incoming.topic}"
            wrong = "ROS002", f"{does}, but refuses this subscriber: {refusal[:300]}"
        self.problem = wrong
        return wrong is None


class Incoming(handshake.Topic):
    """A topic that the node receives."""

    direction, role = "in", "Subscriber"

    def __init__(self, *arguments: Any) -> None:
        super().__init__(*arguments)
        self.publishers: tuple[str, ...] = ()
        self.linking = threading.Lock()  # guards the connections
        self.capsule: object = None  # the sink that they put messages into
        self._links: dict[str, Link] = {}

    def add(self, handle: Any) -> None:
        """Add a subscription."""
        super().add(handle)
        self.route()

    def remove(self, handle: Any) -> None:
        """Remove a subscription."""
        with self.node.turn:
            super().remove(handle)
        self.route()

    def route(self) -> None:
        """Pass received messages to the sink of the subscription, if there is only one and it has a sink."""
        with self.linking:
            sinks = [one.sink for one in self.handles]
            self.capsule = sinks[0].capsule if len(sinks) == 1 and sinks[0] is not None else None
            for link in self._links.values():
                link.divert(self.capsule)

    def links(self) -> tuple[Link, ...]:
        """Return the connections, including those that are being established."""
        with self.linking:
            return tuple(self._links.values())

    def matched(self) -> int:
        """Return the number of connected publishers."""
        return sum(link.connected for link in self.links())

    def problems(self) -> list[Problem]:
        """Return the problems that prevent publishers from being received."""
        named = set(self.publishers)
        links = [link for link in self.links() if not link.connected and link.uri in named]
        return [link.problem for link in links if link.problem is not None]

    def register(self, master: Master) -> None:
        """Register the topic with the master, and note its publishers."""
        named = super().register(master)
        uris = named if isinstance(named, list) else []
        self.publishers = tuple(uri for uri in uris if isinstance(uri, str))

    def update(self) -> None:
        """Connect to every publisher that the master lists, and disconnect from others."""
        now = self.node.clock.monotonic_ns()
        named = dict.fromkeys(self.publishers)
        with self.linking:
            # A connection that works outlives its registration: masters come and go.
            gone = [link for uri, link in self._links.items() if uri not in named and not link.connected]
            for link in gone:
                del self._links[link.uri]
            new = []
            for uri in named if not self._closed else ():
                former = self._links.get(uri)
                if former is None or (former.ended and now >= former.retry_ns):
                    new.append(Link(self, uri, former))
                    self._links[uri] = new[-1]
        for link in gone:
            link.close()
        for link in new:
            link.start()

    def deliver(self, batch: list[bytes]) -> None:
        """Deliver messages to the subscriptions; called by one thread."""
        stamp_ns = self.node.clock.time_ns()
        with self.node.turn:
            for subscription in self.handles:
                subscription.receive(batch, stamp_ns)

    def info(self) -> list[list[Any]]:
        """Return what ``rosnode info`` prints of the connections."""
        return [row for link in self.links() for row in link.info()]

    def close(self) -> tuple[Link, ...]:
        """Disconnect; return the connections, whose threads end soon."""
        with self.linking:
            self._closed = True
            links = tuple(self._links.values())
            self._links.clear()
        for link in links:
            link.close()
        return links


class RospySubscription(BaseSubscription):
    """A subscription; see :class:`rosplc.ros.backend.Subscription`."""

    def __init__(self, on_message: OnMessage, shared: Incoming, qos: Qos) -> None:
        super().__init__(on_message, shared.node, shared.topic, shared.definition.type_name, qos)
        self.shared = shared

    def _matched(self) -> int:
        return self.shared.matched()

    def divert(self, sink: Sink) -> bool:
        """Pass received messages to the sink; see :data:`rosplc.ros.backend.Sink`."""
        self.sink = sink
        self.shared.route()
        return True

    def receive(self, batch: list[bytes], stamp_ns: int) -> None:
        """Deliver the newest ``depth`` of messages that arrived together; the backend's turn is held."""
        self._dropped += max(0, len(batch) - self.qos.depth)
        for payload in batch[-self.qos.depth :]:
            if self.closed:
                return
            self._deliver(payload, stamp_ns)


_FLUSH_NS = 500_000_000  # how long the last messages of a publisher may take to leave


class Peer(NamedTuple):
    """The connection to a subscriber."""

    outgoing: Outgoing
    sock: socket.socket
    node: str

    def end(self, why: str = "") -> None:
        """Close the connection."""
        self.outgoing.leave(self)


class Outgoing(Topic):
    """A topic that the node sends."""

    direction, role = "out", "Publisher"

    def __init__(self, *arguments: Any) -> None:
        super().__init__(*arguments)
        # nodes that were refused: when (monotonic ns), code and words
        self.strangers: dict[str, tuple[int, tuple[str, str]]] = {}
        self.sender = Sender(self.node.outbound.loop)
        self._peers: tuple[Peer, ...] = ()

    @property
    def latching(self) -> bool:
        """Whether late subscribers get the last message."""
        return any(publisher.qos.durability == "transient_local" for publisher in self.handles)

    def subscribers(self) -> frozenset[str]:
        """Return the names of the connected nodes."""
        return frozenset(peer.node for peer in self._peers)

    def matched(self) -> int:
        """Return the number of connected subscribers."""
        return len(self._peers)

    def accept(self, sock: socket.socket, header: dict[str, str]) -> str:
        """Serve a connected subscriber; return the reason for a refusal, or an empty text."""
        node = header.get("callerid", "?")[:256]
        theirs, ours = handshake.peer_type(header), self.definition.identity
        wrong = handshake.mismatch(node, "subscribes to", self.topic, theirs, ours)
        if wrong is not None:
            self.strangers[node] = (self.node.clock.monotonic_ns(), wrong)
            self.node.wake()
            return f"topic {self.topic} is published as {ours[0]} with md5sum {ours[1]}: {wrong[1]}"
        latching = str(int(self.latching))
        fields = {"topic": self.topic, "callerid": self.node.node, "latching": latching}
        handshake.prepare(sock).sendall(handshake.encode_header({**fields, **self.definition.fields()}))
        sock.settimeout(None)
        with self._lock:
            if self._closed:
                return f"topic {self.topic} is no longer published"
            depth = max((publisher.qos.depth for publisher in self.handles), default=1)
            peer = Peer(self, sock, node)
            former = [one for one in self._peers if one.node == node and node != ANY]
            # One that does not read holds `depth` messages, the oldest of which give way, and one more.
            self.sender.add(sock.fileno(), peer, depth, self.latching)
            self._peers += (peer,)
            if theirs[1] != ANY:  # one that was refused asks once more, for any type, to learn why
                self.strangers.pop(node, None)
        for one in former:  # as rospy does: one connection for each node
            one.end()
        self.node.wake()
        return ""

    def leave(self, peer: Peer) -> None:
        """Disconnect a subscriber; a second call does nothing."""
        with self._lock:
            left = tuple(one for one in self._peers if one is not peer)
            there = len(left) < len(self._peers)
            self._peers = left
        if there:
            self.node.outbound.let_go(peer.sock)
            self.node.wake()

    def info(self) -> list[list[Any]]:
        """Return what ``rosnode info`` prints of the connections."""
        ends = [(peer.sock, peer.node) for peer in self._peers]
        return [row for end in ends for row in handshake.connection_info(*end, "o", self.topic)]

    def close(self) -> tuple[Link, ...]:
        """Disconnect, after everything has been sent or a moment has passed."""
        with self._lock:
            self._closed = True
        self.sender.close()
        clock = self.node.clock
        deadline_ns = clock.monotonic_ns() + _FLUSH_NS
        while self.sender.waiting and clock.monotonic_ns() < deadline_ns:
            clock.sleep(1_000_000)
        for peer in self._peers:
            peer.end()
        return ()


class RospyPublisher(BasePublisher):
    """A publisher; see :class:`rosplc.ros.backend.Publisher`.

    ROS 1 messages carry no source stamp, so ``stamp_ns`` is not sent.
    """

    def __init__(self, shared: Outgoing, qos: Qos) -> None:
        super().__init__(shared.node, shared.topic, shared.definition.type_name, qos)
        self.shared = shared
        self._latch = qos.durability == "transient_local"
        self.sink = self._outlet = Outlet(shared.sender, self._latch)

    def _matched(self) -> int:
        return self.shared.matched()

    def open_sink(self, limit_ns: int) -> None:
        """Let messages pass directly; see :data:`rosplc.ros.backend.Sink`."""
        if not self.closed:
            self._outlet.open(limit_ns)

    def write(self, payload: bytes, stamp_ns: int | None = None) -> bool:
        """Send one message; see :meth:`rosplc.ros.backend.Publisher.write`.

        False means that a subscriber's queue was full and this message replaced its oldest one;
        the message then counts as dropped and not as sent.
        The payload is not checked: ROS 1 serialization does not show whether bytes fit a type.

        Raises BackendError: ROS009 after close, ROS015 if the node was asked to shut down.
        """
        if self.closed:
            raise self._closed()
        self._node.usable()
        lost = self.shared.sender.write(bytes(payload), self._latch)
        with self._lock:
            # With one subscriber, sent and dropped add up to what was written.
            self._messages += not lost
            self._dropped += lost
            self._last_ns = self._clock.time_ns()
        return not lost
