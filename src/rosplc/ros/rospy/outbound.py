"""A topic that is sent: a bounded queue and one thread for each subscriber."""

from __future__ import annotations

import contextlib
import select
import socket
import threading
import time
from collections import deque
from typing import Any

from rosplc.clock import Clock
from rosplc.ros._base import BasePublisher
from rosplc.ros.backend import Qos
from rosplc.ros.rospy import handshake
from rosplc.ros.rospy.handshake import ANY, Topic

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
