"""The two servers of a ROS 1 node: its XML-RPC interface and the port where subscribers connect.

http://wiki.ros.org/ROS/Slave_API
"""

from __future__ import annotations

import contextlib
import logging
import os
import socket
import threading
from collections.abc import Callable
from typing import Any
from xmlrpc.server import SimpleXMLRPCDispatcher, SimpleXMLRPCRequestHandler

from rosplc.clock import SYSTEM, Clock
from rosplc.ros.rospy.handshake import TIMEOUT_S, HandshakeError, encode_header, read_header, ros1_name
from rosplc.ros.rospy.master import Address, is_node_uri

_logger = logging.getLogger("rosplc.ros.rospy")

MOST_REQUEST = 4 << 20  # Bytes of a call; the list of a topic's publishers has far less.
MOST_CALLERS = 1000  # Connections that callers may have open at once.
MOST_GREETINGS = 128  # Subscribers whose headers are waited for at once.


class _Api:
    """The Slave API: any node can call any public method, so no arguments are trusted."""

    def __init__(self, master: str, node: Any, place: tuple[str, int]) -> None:
        self._master, self._node, self._place = master, node, place

    def getBusStats(self, caller_id: object) -> tuple[int, str, list[Any]]:
        return 1, "", [[], [], []]

    def getBusInfo(self, caller_id: object) -> tuple[int, str, list[Any]]:
        topics: list[Any] = [*self._node.having("out").values(), *self._node.having("in").values()]
        return 1, "bus info", [row for topic in topics for row in topic.info()]

    def getMasterUri(self, caller_id: object) -> tuple[int, str, str]:
        return 1, self._master, self._master

    def getPid(self, caller_id: object) -> tuple[int, str, int]:
        return 1, "", os.getpid()

    def getSubscriptions(self, caller_id: object) -> tuple[int, str, list[Any]]:
        return 1, "subscriptions", _types(self._node.having("in"))

    def getPublications(self, caller_id: object) -> tuple[int, str, list[Any]]:
        return 1, "publications", _types(self._node.having("out"))

    def paramUpdate(self, caller_id: object, key: object, value: object) -> tuple[int, str, int]:
        if (parameters := self._node.parameters) is None:
            return -1, "not subscribed", 0
        parameters.notice()
        return 1, "", 0

    def publisherUpdate(self, caller_id: object, topic: object, publishers: object) -> tuple[int, str, int]:
        if not isinstance(topic, str) or not isinstance(publishers, list):
            return -1, "expected a topic name and a list of URIs", 0
        self._node.publishers_changed(topic, tuple(uri for uri in publishers if is_node_uri(uri)))
        return 1, "", 0

    def requestTopic(self, caller_id: object, topic: object, protocols: object) -> tuple[int, str, list[Any]]:
        if not isinstance(topic, str) or topic not in self._node.having("out"):
            return -1, f"Not a publisher of [{str(topic)[:256]}]", []
        wanted = protocols if isinstance(protocols, list) else []
        if not any(isinstance(each, list) and each[:1] == ["TCPROS"] for each in wanted):
            return 0, "no supported protocol implementations", []
        host, port = self._place
        return 1, f"ready on {host}:{port}", ["TCPROS", host, port]

    def shutdown(self, caller_id: object, msg: object = "") -> tuple[int, str, int]:
        self._node.told_to_leave(str(caller_id)[:256], str(msg)[:256])
        return 1, "shutdown", 0


def _types(topics: dict[str, Any]) -> list[list[str]]:
    return [[name, ros1_name(topic.definition.type_name)] for name, topic in topics.items()]


class _Request(SimpleXMLRPCRequestHandler):
    """The standard library's handler, with a limit on the announced length."""

    protocol_version = "HTTP/1.1"  # as rospy's: the connection is kept

    def do_POST(self) -> None:
        length = self.headers.get("Content-Length", "")
        if not length.isdigit() or len(length) > 9 or int(length) > MOST_REQUEST:
            self.close_connection = True
            self.send_error(413)
            return
        super().do_POST()

    def log_message(self, *_: object) -> None:
        """Log nothing: there are calls every second."""


class _Dispatcher(SimpleXMLRPCDispatcher):
    """The server interface that the standard library's request handler needs."""

    logRequests = _send_traceback_header = False


class _Listener:
    """Accepts up to ``most`` connections; each has a thread, so that a silent caller delays no other."""

    def __init__(self, bind: str, serve: Callable[[socket.socket], None], most: int, clock: Clock) -> None:
        self._sock = socket.create_server((bind, 0), backlog=128)
        self.port: int = self._sock.getsockname()[1]
        self._serve, self._most, self._clock = serve, most, clock
        self._open: set[socket.socket] = set()
        self._closing = False
        self._thread = threading.Thread(target=self._run, name="rosplc-listen", daemon=True)

    def start(self) -> None:
        """Start to accept connections."""
        self._thread.start()

    def _run(self) -> None:
        while not self._closing:
            try:
                sock, _ = self._sock.accept()
            except OSError:  # closed, or out of files
                if not self._closing:
                    self._clock.sleep(100_000_000)
                continue
            thread = threading.Thread(target=self._work, args=(sock,), name="rosplc-serve", daemon=True)
            self._open.add(sock)
            with contextlib.suppress(RuntimeError):  # out of threads
                if len(self._open) <= self._most:
                    thread.start()
                    continue
            self._open.discard(sock)
            sock.close()

    def _work(self, sock: socket.socket) -> None:
        try:
            self._serve(sock)
        except (HandshakeError, OSError) as error:
            _logger.debug("a connection failed: %s", error)
            sock.close()
        except Exception:
            _logger.exception("error in a connection")
            sock.close()
        finally:
            self._open.discard(sock)

    def close(self) -> None:
        """Stop listening, and close the connections."""
        self._closing = True
        for sock in (self._sock, *tuple(self._open)):
            with contextlib.suppress(OSError):
                sock.shutdown(socket.SHUT_RDWR)
        self._sock.close()
        if self._thread.is_alive() and threading.current_thread() is not self._thread:
            self._thread.join(1.0)


class Servers:
    """Both running servers of one node. Raises OSError if this machine does not have the address."""

    def __init__(self, address: Address, node: Any, clock: Clock = SYSTEM) -> None:
        self._node, self._clock = node, clock
        self.data = _Listener(address.bind, self._greet, MOST_GREETINGS, clock)
        try:
            self.rpc = _Listener(address.bind, self._answer, MOST_CALLERS, clock)
        except OSError:
            self.data.close()
            raise
        # the URI of the node's XML-RPC interface, as the master is told
        self.uri = f"http://{address.host}:{self.rpc.port}/"
        self._api: Any = _Dispatcher()
        self._api.register_multicall_functions()
        self._api.register_instance(_Api(address.master, node, (address.host, self.data.port)))
        for listener in (self.data, self.rpc):
            listener.start()

    def _answer(self, sock: socket.socket) -> None:
        with sock:
            _Request(sock, sock.getpeername(), self._api)

    def _greet(self, sock: socket.socket) -> None:
        sock.settimeout(TIMEOUT_S)
        header = read_header(sock, TIMEOUT_S, self._clock)
        kind = "service" if "service" in header else "topic"
        known = self._node.having("serve" if kind == "service" else "out")
        wanted = known.get(header.get(kind, ""))
        missing = [name for name in (kind, "md5sum", "callerid") if name not in header]
        if missing:
            refusal = f"Missing required '{missing[0]}' field"
        elif wanted is None:
            refusal = f"[{header[kind][:256]}] is not {'provided' if kind == 'service' else 'published'} here"
        else:
            refusal = wanted.accept(sock, header)
        if refusal:
            sock.sendall(encode_header({"error": refusal}))
            sock.close()

    def close(self) -> None:
        """Stop listening."""
        for listener in (self.data, self.rpc):
            listener.close()
