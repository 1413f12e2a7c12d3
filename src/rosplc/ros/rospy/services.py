"""Services over TCPROS: each caller of a server and each call of a client has a connection and a thread.

http://wiki.ros.org/ROS/TCPROS
"""

from __future__ import annotations

import contextlib
import select
import socket
import threading
from dataclasses import dataclass
from typing import Any

from rosplc.reasons import Reason
from rosplc.ros._base import BaseClient, BaseEndpoint, KeepingServer, Problem
from rosplc.ros.backend import Reply
from rosplc.ros.rospy import handshake
from rosplc.ros.rospy.handshake import ANY, HandshakeError
from rosplc.ros.rospy.master import Master

MOST_CALLERS = 1000  # connections to all services of a node
MOST_CALLS = 64  # calls of one client at once; each has a thread
LARGEST = 64 << 20  # bytes of a request or response
_LONGEST_TEXT = 1000  # characters of a server's error

_STUCK_S = 10.0  # a peer that neither sends on nor takes what it asked for is dropped then
_LOOK_S = 1.0  # how often the thread of a caller that waits looks whether it has gone
_RETRY_NS = 1_000_000_000  # after a server that could not be asked; doubled each time
_SLOWEST_NS = 8_000_000_000


def _has_gone(sock: socket.socket) -> bool:
    poller = select.poll()
    poller.register(sock, select.POLLRDHUP)
    return bool(poller.poll(0))


class _Caller:
    """The connection of one caller; ``key`` identifies its open request."""

    def __init__(self, sock: socket.socket, server: RospyServer, persistent: bool) -> None:
        self.sock, self.key = sock, b""
        self._server, self._persistent = server, persistent
        self._lock = threading.Lock()
        self._answered = threading.Event()
        self._frame = b""

    def waits(self, key: bytes) -> bool:
        """Return whether the caller waits for the response to a request."""
        with self._lock:
            return bool(key) and self.key == key and not _has_gone(self.sock)

    def answer(self, key: bytes, frame: bytes) -> bool:
        """Queue the response to a request; False if the caller is gone. Never blocks."""
        with self._lock:
            if not key or self.key != key or _has_gone(self.sock):
                return False
            self.key, self._frame = b"", frame
            self._answered.set()
        return True

    def run(self) -> None:
        """Serve the caller until it disconnects; runs in the caller's thread."""
        server = self._server
        try:
            while self._serve() and self._persistent:
                pass
        except (OSError, HandshakeError) as error:
            server.log.debug("%s: a caller's connection ended: %s", server.topic, error)
        except Exception:
            server.log.exception("%s: error in a caller's connection", server.topic)
        with self._lock:
            self.key = b""
            self.sock.close()
        server.connections.discard(self)

    def _serve(self) -> bool:
        """Serve one request; return whether another may follow."""
        sock = self.sock
        sock.settimeout(None if self._persistent else _STUCK_S)
        start = sock.recv(4)
        sock.settimeout(_STUCK_S)
        size = int.from_bytes(start + _read(sock, 4 - len(start)), "little") if start else 0
        if size > LARGEST:
            self._server.reject(f"a caller announces a request of {size} bytes; the limit is {LARGEST}")
        if not start or size > LARGEST:
            return False
        payload = _read(sock, size)
        self._answered.clear()
        self.key = key = self._server.new_caller()
        self._server.receive(payload, key, 0, self)
        while not self._answered.wait(_LOOK_S):
            if not self.waits(key) and not self._answered.is_set():
                return False
        if not self._persistent:
            self._server.connections.discard(self)
        sock.sendall(self._frame)
        return True


class _Service(BaseEndpoint):
    """The common base of server and client."""

    def __init__(self, *arguments: Any) -> None:
        super().__init__(*arguments)
        self._md5: str = self._node.service_md5(self.type_name)

    def _checked(self, payload: bytes) -> bytes:
        return bytes(payload)  # nothing of ROS 1's bytes shows whether they fit a type


class RospyServer(_Service, KeepingServer):
    """A service that the node serves; see :class:`rosplc.ros.backend.ServiceServer`."""

    receive = KeepingServer._take  # called by the callers' threads

    def __init__(self, *arguments: Any) -> None:
        super().__init__(*arguments)
        self.log = self._node.logger
        self.connections: set[_Caller] = set()

    def _matched(self) -> int:
        return len(self.connections)

    def accept(self, sock: socket.socket, header: dict[str, str]) -> str:
        """Serve a connected caller; return the reason for a refusal, or an empty text."""
        node, md5 = header["callerid"][:256], header["md5sum"][:64]
        if md5 not in (ANY, self._md5):
            self.reject(f"node {node} calls this service with md5sum {md5}, but the local one is {self._md5}")
            return f"service {self.topic} is {self.type_name} with md5sum {self._md5}, not {md5}"
        fields = {"callerid": self._node.node, "service": self.topic, "md5sum": self._md5}
        for name, end in (("type", ""), ("request_type", "Request"), ("response_type", "Response")):
            fields[name] = handshake.ros1_name(self.type_name) + end
        handshake.prepare(sock).sendall(handshake.encode_header(fields))
        if header.get("probe") == "1":
            sock.close()
            return ""
        caller = _Caller(sock, self, header.get("persistent", "").lower() in ("1", "true"))
        with self._lock:
            if self.closed:
                return f"service {self.topic} is no longer provided"
            if sum(one.matched for one in self._node.having("serve").values()) >= MOST_CALLERS:
                return f"{MOST_CALLERS} callers are already connected"
            self.connections.add(caller)
        try:
            threading.Thread(target=caller.run, name="rosplc-caller", daemon=True).start()
        except RuntimeError as error:
            self.connections.discard(caller)
            return f"{error}"
        return ""

    def _answer(self, caller: bytes, origin: _Caller | None, payload: bytes, ok: int = 1) -> bool:
        frame = bytes([ok]) + len(payload).to_bytes(4, "little") + payload
        return origin is not None and origin.answer(caller, frame)

    def refuse(self, caller: bytes, text: str) -> bool:
        """Tell the caller that the call has failed, and why."""
        with self._lock:
            return self._answer(caller, self._callers.pop(caller, None), text.encode(), ok=0)

    def _drop(self, origin: _Caller) -> None:
        self._answer(origin.key, origin, b"the service is no longer served", ok=0)

    def _waits(self, caller: bytes, origin: _Caller) -> bool:
        return origin.waits(caller)

    def register(self, master: Master) -> None:
        """Register the service with the master; as usual in ROS 1, this replaces another node's server."""
        master.call("registerService", self.topic, self._node.service_uri, self._node.uri)

    def unregister(self, master: Master) -> None:
        """Unregister the service."""
        master.call("unregisterService", self.topic, self._node.service_uri)

    def update(self) -> None:
        """Do nothing: callers connect on their own."""

    def close(self) -> None:
        """Stop serving; waiting callers are informed."""
        super().close()
        self.disconnect()

    def disconnect(self) -> None:
        """End the connections of the callers."""
        for caller in tuple(self.connections):  # an answer on its way still leaves
            with contextlib.suppress(OSError):
                caller.sock.shutdown(socket.SHUT_RD)


@dataclass(slots=True)
class _Link:
    """The connection of one call, if established, and whether it is no longer needed."""

    sock: socket.socket | None = None
    stopped: bool = False


class RospyClient(_Service, BaseClient):
    """A service client; see :class:`rosplc.ros.backend.ServiceClient`."""

    def __init__(self, *arguments: Any) -> None:
        super().__init__(*arguments)
        self.problem: Problem = ("", "")  # code and words for what keeps it from being called
        self._place: tuple[str, int] | None = None  # where the server was last reached
        self._servers: frozenset[str] = frozenset()  # as the master knew them when it was looked for
        self._looking = False
        self._retry_ns = self._pause_ns = 0
        self._links: dict[int, _Link] = {}

    def _matched(self) -> int:
        return int(self._place is not None)

    # -- who serves it

    def update(self) -> None:
        """Find the server if the master reports another one, or if it could not be reached."""
        servers = self._node.servers(self.topic)
        now = self._clock.monotonic_ns()
        with self._lock:
            if servers == self._servers and (not servers or self._place or now < self._retry_ns):
                return
            if self._looking or self.closed:
                return
            if servers != self._servers:
                self._pause_ns = 0
            self._servers, self._place, self.problem = servers, None, ("", "")
            self._looking = bool(servers)
        if servers:
            try:
                threading.Thread(target=self._look, name=f"rosplc-{self.topic}", daemon=True).start()
            except RuntimeError:  # no more threads; the next turn finds the server new
                with self._lock:
                    self._looking, self._servers = False, frozenset()

    def _look(self) -> None:
        place, problem = None, ("", "")
        try:
            with self._node.connecting:
                place = self._lookup()
                sock, header = self._connect(place, {"md5sum": ANY, "probe": "1"})
                sock.close()
            theirs = handshake.service_name(header.get("type", ANY))[:256], header.get("md5sum", ANY)[:64]
            node, ours = header.get("callerid", "?")[:256], (self.type_name, self._md5)
            problem = handshake.mismatch(node, "serves", self.topic, theirs, ours) or problem
        except Exception as error:  # a host's name that cannot be one is a UnicodeError
            problem = ("", f"service {self.topic} is registered, but its server cannot be called: {error}")
        finally:
            with self._lock:
                self._looking = False
                self.problem = problem
                self._place = None if problem[1] else place
                self._pause_ns = min(max(_RETRY_NS, 2 * self._pause_ns), _SLOWEST_NS) if problem[1] else 0
                self._retry_ns = self._clock.monotonic_ns() + self._pause_ns
            self._node.wake()

    def _lookup(self) -> tuple[str, int]:
        master = Master(self._node.master_uri, self._node.node, clock=self._clock)
        try:
            return master.service_place(self.topic)
        finally:
            master.close()

    def _connect(
        self, place: tuple[str, int], fields: dict[str, str]
    ) -> tuple[socket.socket, dict[str, str]]:
        fields = {
            "service": self.topic,
            "md5sum": self._md5,
            "type": handshake.ros1_name(self.type_name),
        } | fields
        sock, header = handshake.connect(place, {"callerid": self._node.node, **fields}, self._clock)
        if "error" in header:
            sock.close()
            raise HandshakeError(header["error"][:_LONGEST_TEXT])
        return sock, header

    # -- calls

    def _receivers(self) -> frozenset[str]:
        self._node.usable()
        return self._servers if self._place is not None else frozenset()

    def _send(self, number: int, payload: bytes) -> Reply | None:
        link = _Link()
        with self._lock:
            if len(self._links) >= MOST_CALLS:
                why = f"{MOST_CALLS} calls to {self.topic} are already pending"
                return Reply(None, "not executed", Reason.QUEUE_FULL, why)
            self._links[number] = link
        arguments = (number, link, payload)
        try:
            threading.Thread(target=self._run, args=arguments, name="rosplc-call", daemon=True).start()
        except RuntimeError as error:  # no more threads
            with self._lock:
                self._links.pop(number, None)
            return Reply(None, "not executed", Reason.QUEUE_FULL, f"{self.topic} cannot be called: {error}")
        return None

    def _run(self, number: int, link: _Link, payload: bytes) -> None:
        try:
            reply = self._exchange(link, payload)
        except Exception as error:
            self._node.logger.exception("%s: a call failed", self.topic)
            reply = Reply(text=str(error))
        with self._lock:
            self._links.pop(number, None)
        self.end(number, reply)

    def _exchange(self, link: _Link, payload: bytes) -> Reply:
        sock: socket.socket | None = None
        try:
            sock = self._reach()
            with self._lock:
                link.sock = sock
                if link.stopped:
                    sock.close()
                    return Reply(text="no caller is waiting for the response")
        except Exception as error:  # whatever it is: nothing was sent
            self._look_again()
            return Reply(None, "not executed", Reason.NO_SERVER, f"{self.topic} cannot be called: {error}")
        try:
            sock.settimeout(handshake.TIMEOUT_S)
            sock.sendall(len(payload).to_bytes(4, "little") + payload)
            sock.settimeout(None)  # the server may take its time
            ok = _read(sock, 1)[0]
            sock.settimeout(handshake.TIMEOUT_S)
            size = int.from_bytes(_read(sock, 4), "little")
            body = _read(sock, size)
        except (OSError, HandshakeError) as error:
            if not link.stopped:
                self._look_again()
            return Reply(None, "fate unknown", Reason.SERVER_GONE, f"{self.topic} did not answer: {error}")
        finally:
            sock.close()
        if ok:
            return Reply(body)
        text = body[:_LONGEST_TEXT].decode(errors="replace")
        return Reply(None, "fate unknown", Reason.SERVER_FAILED, text)

    def _look_again(self) -> None:
        with self._lock:
            self._place = None
        self._node.wake()

    def _reach(self) -> socket.socket:
        place = self._place
        if place is not None:
            with contextlib.suppress(OSError, HandshakeError):
                return self._connect(place, {})[0]
        # It may have been restarted since it was last reached.
        place = self._lookup()
        sock, _ = self._connect(place, {})
        with self._lock:
            self._place = place
        return sock

    def forget(self, number: int) -> None:
        """Stop waiting for a call: its connection is closed."""
        super().forget(number)
        if (link := self._links.get(number)) is not None:
            self._stop(link)

    def close(self) -> None:
        """End every open call with ``fate unknown``."""
        super().close()
        for link in tuple(self._links.values()):
            self._stop(link)

    def _stop(self, link: _Link) -> None:
        with self._lock, contextlib.suppress(OSError):
            link.stopped = True
            if link.sock is not None:
                link.sock.shutdown(socket.SHUT_RDWR)


def _read(sock: socket.socket, size: int) -> bytes:
    """Read ``size`` bytes. Raises HandshakeError if they are too many or the connection ends early."""
    if size > LARGEST:
        raise HandshakeError(f"it announces {size} bytes; the limit is {LARGEST}")
    data = bytearray()
    while len(data) < size:
        part = sock.recv(min(1 << 20, size - len(data)))
        if not part:
            raise HandshakeError("it closed the connection")
        data += part
    return bytes(data)
