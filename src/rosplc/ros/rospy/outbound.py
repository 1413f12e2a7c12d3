"""A topic that is sent: a bounded queue and one thread for each subscriber, as rospy has it."""

from __future__ import annotations

import select
import socket
import threading
import time
from collections.abc import Callable
from typing import Any

from rosplc.clock import SYSTEM, Clock
from rosplc.ros._base import BasePublisher
from rosplc.ros.backend import Qos
from rosplc.ros.rospy.debian import QueuedConnection, TCPROSPub, TCPROSTransport
from rosplc.ros.rospy.handshake import ANY, mismatch, peer_type, write_header
from rosplc.ros.rospy.inbound import raw_class

__all__ = ["Outgoing", "RospyPublisher"]

_FLUSH_S = 0.5  # how long the last messages of a publisher may take to leave
_GONE = select.POLLHUP | select.POLLERR | select.POLLRDHUP | select.POLLNVAL


class _Queue(QueuedConnection):  # type: ignore[misc]
    """rospy's queue before a connection, which here tells when it drops a message.

    rospy's takes out everything at once and then sends it, so it would hold twice its size. Here a
    subscriber that stands still holds ``depth`` messages and the one that is being sent.
    """

    _busy = False
    _rest: bytes | memoryview = b""

    def write_data(self, data: bytes) -> bool:
        """Send or queue a message; return False if the oldest had to give way. Never blocks.

        While nothing waits, the message goes out from here: waking the thread would cost more than
        all the rest of its way.
        """
        with self._lock:
            if self._error is not None:
                raise self._error
            if not (self._queue or self._rest or self._busy) and (sent := self._send(data)):
                if sent < len(data):
                    self._rest = memoryview(data)[sent:]  # what has begun cannot give way any more
                    self._cond_data_available.notify_all()
                return True
            full = len(self._queue) >= self._queue_size
            if full:
                del self._queue[0]
            self._queue.append(data)
            self._cond_data_available.notify_all()
        return not full

    def _send(self, data: bytes) -> int:
        connection = self._connection
        if connection.done or (sock := connection.socket) is None:
            raise BrokenPipeError
        try:
            sent: int = sock.send(data, socket.MSG_DONTWAIT)
        except BlockingIOError:
            return 0
        if sent == len(data):
            connection.stat_bytes += sent
            connection.stat_num_msg += 1
        return sent

    def _run(self) -> None:
        connection, news = self._connection, self._cond_data_available
        while True:
            with self._lock:
                self._busy = False
                if not self._queue and not self._rest:
                    news.notify_all()
                while not self._queue and not self._rest and not connection.done:
                    news.wait()
                if connection.done:
                    return
                if self._rest:
                    data, self._rest = self._rest, b""
                else:
                    data = self._queue.pop(0)
                self._busy = True
            try:
                connection.write_data(data)
            except Exception as error:
                with self._lock:
                    self._error = error
                    self._queue.clear()
                    news.notify_all()
                return

    def flush(self, deadline: float) -> None:
        """Wait until everything has gone out, at most to a point in time (monotonic seconds)."""
        with self._lock:
            while (
                (self._queue or self._rest or self._busy)
                and self._error is None
                and not self._connection.done
            ):
                if not self._cond_data_available.wait(max(0.0, deadline - time.monotonic())):
                    return

    def close(self) -> None:
        """Disconnect; the thread ends."""
        self._connection.close()

    def join(self) -> None:
        """Wait a moment for the thread."""
        if self._thread is not threading.current_thread():
            self._thread.join(1.0)


class Outgoing:
    """One topic that the node sends.

    Args:
        caller: The full name of the node.
        topic: The topic.
        type_name: Its type, ``package/msg/Name``.
        md5: The type's MD5 sum.
        text: The type's definition.
        changed: Called when a connection comes or goes.

    Attributes:
        strangers: Nodes that were refused: when (monotonic seconds), code and words.
    """

    direction = "out"

    def __init__(
        self, caller: str, topic: str, type_name: str, md5: str, text: str, changed: Callable[[], None]
    ) -> None:
        self.topic = topic
        self.type_name = type_name
        self.identity = (type_name, md5)
        self.kind = raw_class(type_name, md5, text)
        self.strangers: dict[str, tuple[float, tuple[str, str]]] = {}
        self._caller = caller
        self._changed = changed
        self._lock = threading.Lock()
        self._queues: tuple[Any, ...] = ()
        self._closed = False
        self._latched: bytes | None = None
        self.publishers: tuple[RospyPublisher, ...] = ()

    @property
    def latching(self) -> bool:
        """Whether late subscribers get the last message."""
        return any(p.qos.durability == "transient_local" for p in self.publishers)

    def subscribers(self) -> frozenset[str]:
        """Return the names of the nodes that are connected."""
        return frozenset(queue.endpoint_id for queue in self._queues if not queue.done)

    def matched(self) -> int:
        """Return how many subscribers are connected."""
        return sum(not queue.done for queue in self._queues)

    def accept(self, sock: socket.socket, address: tuple[str, int], header: dict[str, str]) -> str:
        """Serve a subscriber that has connected; return why not, or an empty text."""
        node = header.get("callerid", "?")[:256]
        wrong = mismatch(node, "subscribes to", self.topic, peer_type(header), self.identity)
        if wrong is not None:
            self.strangers[node] = (time.monotonic(), wrong)
            self._changed()
            name, md5 = self.identity
            return f"topic {self.topic} is {name} with md5sum {md5} here: {wrong[1]}"
        sock.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        fields = TCPROSPub(self.topic, self.kind, self.latching, {"callerid": self._caller})
        transport = TCPROSTransport(fields, self.topic)
        transport.set_socket(sock, node)
        transport.remote_endpoint = address
        write_header(sock, fields.get_header_fields())
        sock.settimeout(None)
        with self._lock:
            if self._closed:
                return f"topic {self.topic} is no longer published"
            depth = max((p.qos.depth for p in self.publishers), default=1)
            queue = _Queue(transport, depth)
            former = [q for q in self._queues if q.endpoint_id == node and node != ANY]
            if self._latched is not None and self.latching:
                queue.write_data(self._latched)
            self._queues = (*(q for q in self._queues if q not in former), queue)
            if peer_type(header)[1] != ANY:  # one that was refused asks once more, for any type, to learn why
                self.strangers.pop(node, None)
        for one in former:  # as rospy does: one connection for each node
            one.close()
        self._changed()
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
                    lost += not queue.write_data(frame)
                except Exception:  # the error that its thread met: the subscriber has gone
                    failed.append(queue)
            if failed:
                self._queues = tuple(queue for queue in self._queues if queue not in failed)
        for queue in failed:
            queue.close()
        if self._queues:
            time.sleep(0)  # as rospy does: lets the threads of queues and receivers run now
        return lost

    def check(self) -> None:
        """Forget subscribers that have closed the connection; nobody reads from it to notice."""
        queues = {queue.fileno(): queue for queue in self._queues if not queue.done}
        poller = select.poll()
        for number in queues:
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
        return [
            [q.id, q.endpoint_id, "o", "TCPROS", self.topic, True, q.get_transport_info()]
            for q in self._queues
        ]

    def add(self, publisher: RospyPublisher) -> None:
        """Serve one more publisher."""
        with self._lock:
            self.publishers += (publisher,)

    def remove(self, publisher: RospyPublisher) -> int:
        """Serve it no longer; return how many publishers are left."""
        with self._lock:
            self.publishers = tuple(p for p in self.publishers if p is not publisher)
            return len(self.publishers)

    def close(self) -> tuple[Any, ...]:
        """Disconnect; return the queues, whose threads are about to end."""
        with self._lock:
            self._closed = True
            queues, self._queues = self._queues, ()
        deadline = time.monotonic() + _FLUSH_S
        for queue in queues:
            queue.flush(deadline)
            queue.close()
        return queues


class RospyPublisher(BasePublisher):
    """A topic that is being sent; see :class:`rosplc.ros.backend.Publisher`.

    ROS 1 carries no source stamp, so ``stamp_ns`` goes no further than the bridge.
    """

    def __init__(
        self,
        outgoing: Outgoing,
        qos: Qos,
        diagnose: Callable[[Outgoing], tuple[str, str]],
        forget: Callable[[RospyPublisher], None],
        usable: Callable[[], None],
        clock: Clock = SYSTEM,
    ) -> None:
        super().__init__(outgoing.topic, outgoing.type_name, qos, forget, clock)
        self.outgoing = outgoing
        self._latch = qos.durability == "transient_local"
        self._diagnose = diagnose
        self._usable = usable
        self._count = threading.Lock()

    def _matched(self) -> int:
        return self.outgoing.matched()

    def _problem(self) -> tuple[str, str]:
        return self._diagnose(self.outgoing)

    def write(self, payload: bytes, stamp_ns: int | None = None) -> bool:
        """Send one message; see :meth:`rosplc.ros.backend.Publisher.write`.

        False means that a subscriber's queue was full and its oldest message gave way to this one;
        the message then counts as dropped and not as sent.
        The payload is not looked into: nothing of ROS 1's bytes shows whether they fit a type.

        Raises:
            BackendError: ROS009 after close, ROS015 if the node was told to leave.
        """
        if self.closed:
            raise self._closed()
        self._usable()
        lost = self.outgoing.send(bytes(payload), self._latch)
        with self._count:
            # With one subscriber, sent and dropped add up to what was written.
            self._messages += not lost
            self._dropped += lost
            self._last_ns = self._clock.time_ns()
        return not lost
