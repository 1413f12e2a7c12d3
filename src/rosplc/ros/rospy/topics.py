"""Topics: one connection and one thread for each publisher that is received, and for each subscriber.

All subscriptions of the node to one topic share the connections: a publisher knows a subscriber by
its node's name and keeps one connection for each.
"""

from __future__ import annotations

import contextlib
import logging
import select
import socket
import threading
import time
from collections import deque
from typing import Any

from rosplc.clock import Clock
from rosplc.ros._base import BasePublisher, BaseSubscription, Problem
from rosplc.ros.backend import OnMessage, Qos
from rosplc.ros.rospy import handshake
from rosplc.ros.rospy.handshake import ANY, Topic
from rosplc.ros.rospy.master import Master, RefusedError, UnreachableError, call, proxy

_logger = logging.getLogger("rosplc.ros.rospy")

_RETRY_NS = 1_000_000_000  # after a lost connection; doubled with each attempt that fails
_SLOWEST_NS = 8_000_000_000
_REFUSED_NS = 60_000_000_000  # a publisher with another type logs each attempt
LARGEST_MESSAGE = 1 << 30  # a length beyond this is no message but a stream out of step
_READ = 65536

# Of a subscriber that takes whatever a topic carries.
ANY_TYPE = handshake.Definition(handshake.ANY, handshake.ANY, "")


def request(uri: str, caller: str, topic: str) -> tuple[str, int]:
    """Ask a node for a topic; return host and port. Raises UnreachableError, RefusedError: Not its topic."""
    server = proxy(uri, handshake.TIMEOUT_S)
    try:
        answer = call(server, "requestTopic", caller, topic, [["TCPROS"]])
    finally:
        server("close")()
    if isinstance(answer, list) and len(answer) == 3 and answer[0] == "TCPROS":
        host, port = answer[1:]
        if isinstance(host, str) and isinstance(port, int) and 0 < port < 65536:
            return host, port
    raise UnreachableError(f"its answer is none of ROS: {str(answer)[:200]}")


def greet(
    place: tuple[str, int], caller: str, topic: str, definition: handshake.Definition
) -> tuple[socket.socket, dict[str, str]]:
    """Connect as a subscriber; return the connection and the header. Raises OSError, HandshakeError."""
    return handshake.connect(
        place, {"callerid": caller, "topic": topic, "tcp_nodelay": "1", **definition.fields()}
    )


def cut(buffer: bytearray) -> list[bytes]:
    """Take the whole messages out of a stream's bytes. Raises HandshakeError: A length is none."""
    found, at, end = [], 0, len(buffer)
    with memoryview(buffer) as view:
        while end - at >= 4:
            length = int.from_bytes(view[at : at + 4], "little")
            if length > LARGEST_MESSAGE:
                raise handshake.HandshakeError(f"a message of {length} bytes is announced")
            if end - at - 4 < length:
                break
            found.append(bytes(view[at + 4 : at + 4 + length]))
            at += 4 + length
    del buffer[:at]
    return found


class Link:
    """The connection to one publisher, and the thread that reads from it."""

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
        """Begin to connect."""
        self._thread.start()

    def close(self) -> None:
        """Disconnect; the thread ends soon."""
        self._closing = True
        if (sock := self._sock) is not None:
            with contextlib.suppress(OSError):
                sock.shutdown(socket.SHUT_RDWR)

    def join(self) -> None:
        """Wait a moment for the thread, unless this is it."""
        if self._thread.is_alive() and threading.current_thread() is not self._thread:
            self._thread.join(1.0)

    def info(self) -> list[list[Any]]:
        """Return what ``rosnode info`` prints of the connection, if it is there."""
        if not self.connected or self._sock is None:
            return []
        return handshake.connection_info(self._sock, self.uri, "i", self._incoming.topic)

    def _run(self) -> None:
        incoming = self._incoming
        topic = incoming.topic
        try:
            with incoming.node.connecting:
                if self._closing:
                    return
                place = request(self.uri, incoming.node.node, topic)
                self._sock, header = greet(place, incoming.node.node, topic, incoming.definition)
            if self._fits(header, place):
                self.problem = None
                self.pause_ns = _RETRY_NS
                self.connected = not self._closing
                incoming.node.wake()
                self._receive(self._sock)
        except RefusedError as error:
            self.problem = None
            # It has withdrawn the topic, and the master's list has not followed yet.
            _logger.debug("%s: %s: %s", topic, self.uri, error)
        except (OSError, UnreachableError, handshake.HandshakeError) as error:
            text = f"{getattr(error, 'strerror', None) or error}"
            self.problem = ("", f"the node at {self.uri} publishes {topic}, but {text}")
        except Exception as error:
            if not self._closing:
                _logger.exception("%s: the connection to %s had an error", topic, self.uri)
                self.problem = ("", f"the connection to {self.uri} had an error: {error}")
        finally:
            self.connected = False
            if self._sock is not None:
                self._sock.close()
            self.ended = True
            pause = _REFUSED_NS if self.problem is not None and self.problem[0] else self.pause_ns
            self.retry_ns = incoming.node.clock.monotonic_ns() + pause
            incoming.node.wake()

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

    def _receive(self, sock: socket.socket) -> None:
        sock.settimeout(None)
        buffer = bytearray()
        try:
            while not self._closing and (part := sock.recv(_READ)):
                buffer += part
                if messages := cut(buffer):
                    self._incoming.deliver(messages)
        except (OSError, handshake.HandshakeError) as error:
            if not self._closing:
                _logger.debug("%s: the connection to %s ended: %s", self._incoming.topic, self.node, error)


class Incoming(handshake.Topic):
    """One topic that the node receives."""

    direction, role = "in", "Subscriber"

    def __init__(self, *arguments: Any) -> None:
        super().__init__(*arguments)
        self.publishers: tuple[str, ...] = ()
        self._lock = self.node.turn  # held while messages are handed over: one call at a time in the backend
        self._linking = threading.Lock()
        self._links: dict[str, Link] = {}

    def links(self) -> tuple[Link, ...]:
        """Return the connections, made or being made."""
        with self._linking:
            return tuple(self._links.values())

    def matched(self) -> int:
        """Return how many publishers are connected."""
        return sum(link.connected for link in self.links())

    def problems(self) -> list[Problem]:
        """Return what keeps publishers from being received."""
        named = set(self.publishers)
        links = [link for link in self.links() if not link.connected and link.uri in named]
        return [link.problem for link in links if link.problem is not None]

    def register(self, master: Master) -> None:
        """Tell the master of the topic, and take in who publishes it."""
        named = super().register(master)
        self.publishers = (
            tuple(uri for uri in named if isinstance(uri, str)) if isinstance(named, list) else ()
        )

    def update(self) -> None:
        """Connect to every publisher that the master names, and leave those that it no longer names."""
        now = self.node.clock.monotonic_ns()
        named = dict.fromkeys(self.publishers)
        with self._linking:
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
        """Hand messages to the subscriptions; called by the connections' threads."""
        stamp_ns = self.node.clock.time_ns()
        with self._lock:
            for subscription in self.handles:
                subscription.receive(batch, stamp_ns)

    def info(self) -> list[list[Any]]:
        """Return what ``rosnode info`` prints of the connections."""
        return [row for link in self.links() for row in link.info()]

    def close(self) -> tuple[Link, ...]:
        """Disconnect; return the connections, whose threads are about to end."""
        with self._linking:
            self._closed = True
            links = tuple(self._links.values())
            self._links.clear()
        for link in links:
            link.close()
        return links


class RospySubscription(BaseSubscription):
    """A topic that is being received; see :class:`rosplc.ros.backend.Subscription`."""

    def __init__(self, on_message: OnMessage, shared: Incoming, qos: Qos) -> None:
        super().__init__(on_message, shared.node, shared.topic, shared.definition.type_name, qos)
        self.shared = shared

    def _matched(self) -> int:
        return self.shared.matched()

    def receive(self, batch: list[bytes], stamp_ns: int) -> None:
        """Take messages that arrived together, the newest ``depth``; the backend's turn is held."""
        late = len(batch) - self.qos.depth
        if late > 0:
            self._dropped += late
            batch = batch[late:]
        for payload in batch:
            if self.closed:
                return
            self._deliver(payload, stamp_ns)


_FLUSH_NS = 500_000_000  # how long the last messages of a publisher may take to leave
_GONE = select.POLLHUP | select.POLLERR | select.POLLRDHUP | select.POLLNVAL


class _Queue:
    """The connection to a subscriber; one that does not read holds ``depth`` messages and one more."""

    def __init__(self, sock: socket.socket, node: str, depth: int, clock: Clock) -> None:
        self.sock, self.node = sock, node
        self.done = False
        self._depth, self._clock = depth, clock
        self._news = threading.Condition()
        self._idle = threading.Event()  # nothing waits, or the connection has ended
        self._idle.set()
        self._waiting: deque[bytes | memoryview] = deque()
        self._begun: bytes | memoryview = b""  # the rest of a message that has begun: it cannot give way
        self._thread = threading.Thread(target=self._run, name=f"rosplc-to-{node}", daemon=True)
        self._thread.start()

    def write(self, data: bytes) -> bool:
        """Send or queue a message; return False if the oldest had to give way. Never blocks.

        While nothing waits, the message goes out from here: waking the thread would cost more than
        all the rest of its way.

        Raises OSError: The subscriber has gone.
        """
        with self._news:
            if self.done:
                raise BrokenPipeError
            if self._idle.is_set():
                sent = self._send(data)
                if sent == len(data):
                    return True
                self._idle.clear()
                if sent:
                    self._begun = memoryview(data)[sent:]
                    self._news.notify()
                    return True
            full = len(self._waiting) >= self._depth
            if full:
                self._waiting.popleft()
            self._waiting.append(data)
            self._news.notify()
        return not full

    def _send(self, data: bytes) -> int:
        try:
            return self.sock.send(data, socket.MSG_DONTWAIT)
        except BlockingIOError:
            return 0

    def _run(self) -> None:
        while True:
            with self._news:
                while not self.done and not self._waiting and not self._begun:
                    self._idle.set()
                    self._news.wait()
                if self.done:
                    break
                data, self._begun = self._begun or self._waiting.popleft(), b""
            try:
                self.sock.sendall(data)
            except OSError:
                self.done = True
        self._idle.set()
        self.sock.close()

    def flush(self, deadline_ns: int) -> None:
        """Wait until everything has gone out, at most to a point in time."""
        self._clock.wait(self._idle, deadline_ns - self._clock.monotonic_ns())

    def close(self) -> None:
        """Disconnect; the thread ends."""
        with self._news:
            self.done = True
            self._news.notify()
        with contextlib.suppress(OSError):
            self.sock.shutdown(socket.SHUT_RDWR)

    def join(self) -> None:
        """Wait a moment for the thread."""
        if self._thread is not threading.current_thread():
            self._thread.join(1.0)


class Outgoing(Topic):
    """One topic that the node sends."""

    direction, role = "out", "Publisher"

    def __init__(self, *arguments: Any) -> None:
        super().__init__(*arguments)
        # nodes that were refused: when (monotonic ns), code and words
        self.strangers: dict[str, tuple[int, tuple[str, str]]] = {}
        self._queues: tuple[_Queue, ...] = ()
        self._latched: bytes | None = None

    @property
    def latching(self) -> bool:
        """Whether late subscribers get the last message."""
        return any(publisher.qos.durability == "transient_local" for publisher in self.handles)

    def subscribers(self) -> frozenset[str]:
        """Return the names of the nodes that are connected."""
        return frozenset(queue.node for queue in self._queues if not queue.done)

    def matched(self) -> int:
        """Return how many subscribers are connected."""
        return sum(not queue.done for queue in self._queues)

    def accept(self, sock: socket.socket, header: dict[str, str]) -> str:
        """Serve a subscriber that has connected; return why not, or an empty text."""
        node = header.get("callerid", "?")[:256]
        theirs, ours = handshake.peer_type(header), self.definition.identity
        wrong = handshake.mismatch(node, "subscribes to", self.topic, theirs, ours)
        if wrong is not None:
            self.strangers[node] = (self.node.clock.monotonic_ns(), wrong)
            self.node.wake()
            return f"topic {self.topic} is {ours[0]} with md5sum {ours[1]} here: {wrong[1]}"
        latching = str(int(self.latching))
        fields = {"topic": self.topic, "callerid": self.node.node, "latching": latching}
        handshake.prepare(sock).sendall(handshake.encode_header({**fields, **self.definition.fields()}))
        sock.settimeout(None)
        with self._lock:
            if self._closed:
                return f"topic {self.topic} is no longer published"
            depth = max((publisher.qos.depth for publisher in self.handles), default=1)
            queue = _Queue(sock, node, depth, self.node.clock)
            former = [q for q in self._queues if q.node == node and node != ANY]
            if self._latched is not None and self.latching:
                with contextlib.suppress(OSError):
                    queue.write(self._latched)
            self._queues = (*(q for q in self._queues if q not in former), queue)
            if theirs[1] != ANY:  # one that was refused asks once more, for any type, to learn why
                self.strangers.pop(node, None)
        for one in former:  # as rospy does: one connection for each node
            one.close()
        self.node.wake()
        return ""

    def send(self, payload: bytes, latch: bool) -> int:
        """Queue a message for every subscriber; return how many messages had to give way."""
        frame = len(payload).to_bytes(4, "little") + payload
        lost = 0
        failed = []
        with self._lock:
            if latch:
                self._latched = frame
            for queue in self._queues:
                try:
                    lost += not queue.write(frame)
                except OSError:  # the subscriber has gone
                    failed.append(queue)
            if failed:
                self._queues = tuple(queue for queue in self._queues if queue not in failed)
        for queue in failed:
            queue.close()
        if self._queues:
            time.sleep(0)  # as rospy does: lets the threads of queues and receivers run now
        return lost

    def update(self) -> None:
        """Forget subscribers that have closed the connection: nothing is read from it to notice."""
        queues = {queue.sock.fileno(): queue for queue in self._queues if not queue.done}
        poller = select.poll()
        for number in queues:
            if number >= 0:  # it may end at this moment
                poller.register(number, _GONE)
        gone = [queues[number] for number, _ in poller.poll(0)]
        gone += [queue for queue in self._queues if queue.done]
        if gone:
            with self._lock:
                self._queues = tuple(queue for queue in self._queues if queue not in gone)
            for queue in gone:
                queue.close()

    def info(self) -> list[list[Any]]:
        """Return what ``rosnode info`` prints of the connections."""
        ends = [(queue.sock, queue.node) for queue in self._queues]
        return [row for end in ends for row in handshake.connection_info(*end, "o", self.topic)]

    def close(self) -> tuple[_Queue, ...]:
        """Disconnect; return the queues, whose threads are about to end."""
        with self._lock:
            self._closed = True
            queues, self._queues = self._queues, ()
        deadline_ns = self.node.clock.monotonic_ns() + _FLUSH_NS
        for queue in queues:
            queue.flush(deadline_ns)
            queue.close()
        return queues


class RospyPublisher(BasePublisher):
    """A topic that is being sent; see :class:`rosplc.ros.backend.Publisher`.

    ROS 1 carries no source stamp, so ``stamp_ns`` goes no further than the bridge.
    """

    def __init__(self, shared: Outgoing, qos: Qos) -> None:
        super().__init__(shared.node, shared.topic, shared.definition.type_name, qos)
        self.shared = shared
        self._latch = qos.durability == "transient_local"

    def _matched(self) -> int:
        return self.shared.matched()

    def write(self, payload: bytes, stamp_ns: int | None = None) -> bool:
        """Send one message; see :meth:`rosplc.ros.backend.Publisher.write`.

        False means that a subscriber's queue was full and its oldest message gave way to this one;
        the message then counts as dropped and not as sent.
        The payload is not looked into: nothing of ROS 1's bytes shows whether they fit a type.

        Raises BackendError: ROS009 after close, ROS015 if the node was told to leave.
        """
        if self.closed:
            raise self._closed()
        self._node.usable()
        lost = self.shared.send(bytes(payload), self._latch)
        with self._lock:
            # With one subscriber, sent and dropped add up to what was written.
            self._messages += not lost
            self._dropped += lost
            self._last_ns = self._clock.time_ns()
        return not lost
