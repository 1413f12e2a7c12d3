"""The two servers of a ROS 1 node: its XML-RPC interface and the port where subscribers connect.

http://wiki.ros.org/ROS/Slave_API; rospy's own answer it, with what belongs to one node alone in
place of rospy's state of the whole process.
"""

from __future__ import annotations

import contextlib
import logging
import socket
import threading
from typing import Any, Protocol

from rosplc.ros.rospy.address import Address, is_node_uri
from rosplc.ros.rospy.debian import (
    ROSHandler,
    SilenceableXMLRPCRequestHandler,
    TCPServer,
    ThreadingXMLRPCServer,
)
from rosplc.ros.rospy.handshake import HandshakeError, read_header, write_header
from rosplc.ros.rospy.inbound import Incoming
from rosplc.ros.rospy.outbound import Outgoing

__all__ = ["MOST_CALLERS", "MOST_GREETINGS", "MOST_REQUEST", "Servers", "Topics"]

_logger = logging.getLogger("rosplc.ros.rospy")

MOST_REQUEST = 4 << 20
"""Bytes of a call; the list of a topic's publishers has far less."""
MOST_CALLERS = 1000
"""Connections that callers may have open at once."""
MOST_GREETINGS = 128
"""Subscribers whose headers are waited for at once."""

_TIMEOUT_S = 5.0


class Topics(Protocol):
    """What the servers ask of the node."""

    def incoming(self) -> dict[str, Incoming]:
        """Return the topics that are received."""

    def outgoing(self) -> dict[str, Outgoing]:
        """Return the topics that are sent."""

    def publishers_changed(self, topic: str, uris: tuple[str, ...]) -> None:
        """Take the master's word for who publishes a topic."""

    def told_to_leave(self, caller: str, why: str) -> None:
        """Take the demand to shut down."""


class _Handler(ROSHandler):  # type: ignore[misc]
    """Every public method is callable by any node; so nothing here trusts its arguments."""

    def __init__(self, node: str, master: str, topics: Topics) -> None:
        # Not rospy's own constructor: it would hand registration to a thread of rospy's.
        self.masterUri = master
        self.name = node
        self.uri = ""
        self.done = False
        self.protocol_handlers: list[Any] = []
        self.reg_man = None
        self._topics = topics
        self._place: tuple[str, int] = ("", 0)

    def getBusStats(self, caller_id: str) -> tuple[int, str, list[Any]]:
        return 1, "", [[], [], []]

    def getBusInfo(self, caller_id: str) -> tuple[int, str, list[Any]]:
        out = [row for topic in self._topics.outgoing().values() for row in topic.info()]
        into = [link.info() for t in self._topics.incoming().values() for link in t.links() if link.connected]
        return 1, "bus info", [*out, *into]

    def getSubscriptions(self, caller_id: str) -> tuple[int, str, list[Any]]:
        return 1, "subscriptions", [[n, t.kind._type] for n, t in self._topics.incoming().items()]

    def getPublications(self, caller_id: str) -> tuple[int, str, list[Any]]:
        return 1, "publications", [[n, t.kind._type] for n, t in self._topics.outgoing().items()]

    def paramUpdate(self, caller_id: str, key: object, value: object) -> tuple[int, str, int]:
        return -1, "not subscribed", 0

    def publisherUpdate(self, caller_id: str, topic: object, publishers: object) -> tuple[int, str, int]:
        if not isinstance(topic, str) or not isinstance(publishers, list):
            return -1, "a topic's name and a list of URIs are expected", 0
        self._topics.publishers_changed(topic, tuple(uri for uri in publishers if is_node_uri(uri)))
        return 1, "", 0

    def requestTopic(self, caller_id: str, topic: object, protocols: object) -> tuple[int, str, list[Any]]:
        if topic not in self._topics.outgoing():
            return -1, f"Not a publisher of [{str(topic)[:256]}]", []
        wanted = protocols if isinstance(protocols, list) else []
        if not any(isinstance(each, list) and each[:1] == ["TCPROS"] for each in wanted):
            return 0, "no supported protocol implementations", []
        host, port = self._place
        return 1, f"ready on {host}:{port}", ["TCPROS", host, port]

    def shutdown(self, caller_id: object, msg: object = "") -> tuple[int, str, int]:
        self._topics.told_to_leave(str(caller_id)[:256], str(msg)[:256])
        return 1, "shutdown", 0


class _Request(SilenceableXMLRPCRequestHandler):  # type: ignore[misc]
    """rospy's, which believes any announced length."""

    def do_POST(self) -> None:
        length = self.headers.get("Content-Length", "")
        if not length.isdigit() or len(length) > 9 or int(length) > MOST_REQUEST:
            self.close_connection = True
            self.send_error(413)
            return
        super().do_POST()


class _SlaveServer(ThreadingXMLRPCServer):  # type: ignore[misc]
    """rospy's server, which here also ends the connections that callers keep open."""

    def __init__(self, bind: str) -> None:
        self._connections: set[socket.socket] = set()
        super().__init__((bind, 0), log_requests=0)
        self.RequestHandlerClass = _Request

    def process_request(self, request: socket.socket, client_address: Any) -> None:
        if len(self._connections) >= MOST_CALLERS:
            request.close()
            return
        self._connections.add(request)
        super().process_request(request, client_address)

    def shutdown_request(self, request: socket.socket) -> None:
        self._connections.discard(request)
        super().shutdown_request(request)

    def close(self) -> None:
        """Stop serving."""
        stopping = threading.Thread(target=self.shutdown, name="rosplc-stop", daemon=True)
        stopping.start()
        host, port = self.server_address[:2]
        with contextlib.suppress(OSError):  # a connection ends its wait, which lasts half a second
            socket.create_connection(("127.0.0.1" if host == "0.0.0.0" else host, port), 1.0).close()
        stopping.join()
        self.server_close()
        for request in tuple(self._connections):
            with contextlib.suppress(OSError):
                request.shutdown(socket.SHUT_RDWR)


class _DataServer(TCPServer):  # type: ignore[misc]
    """rospy's server for connections of subscribers, at an address of one node's own."""

    def __init__(self, bind: str, serve: Any) -> None:
        self._bind = bind
        super().__init__(serve)

    def _create_server_sock(self) -> socket.socket:
        sock = socket.create_server((self._bind, 0), backlog=128)
        self.addr, self.port = sock.getsockname()
        return sock

    def shutdown(self) -> None:
        """Stop listening; closing alone would leave rospy's thread waiting for one more connection."""
        self.is_shutdown = True
        with contextlib.suppress(OSError):
            self.server_sock.shutdown(socket.SHUT_RDWR)
        self.server_sock.close()


class Servers:
    """Both servers of one node, running.

    Args:
        node: The node's full name.
        address: Where to listen, and what to tell others.
        topics: What is received and sent.

    Attributes:
        uri: The URI of the node's XML-RPC interface, as the master is told.

    Raises:
        OSError: There is no such address here.
    """

    def __init__(self, node: str, address: Address, topics: Topics) -> None:
        self._topics = topics
        self._greetings = threading.Semaphore(MOST_GREETINGS)
        self._rpc = _SlaveServer(address.bind)
        try:
            self._data = _DataServer(address.bind, self._serve)
        except OSError:
            self._rpc.server_close()
            raise
        self.uri = f"http://{address.host}:{self._rpc.server_address[1]}/"
        handler = _Handler(node, address.master, topics)
        handler.uri = self.uri
        handler._place = (address.host, self._data.port)
        self._rpc.register_multicall_functions()
        self._rpc.register_instance(handler)
        self._threads = [
            threading.Thread(target=work, name=f"rosplc-{name}", daemon=True)
            for name, work in (("rpc", self._rpc.serve_forever), ("tcpros", self._data.run))
        ]
        for thread in self._threads:
            thread.start()

    def _serve(self, sock: socket.socket, address: tuple[str, int]) -> None:
        # In a thread of its own: a caller that says nothing must not keep others waiting.
        if not self._greetings.acquire(blocking=False):
            sock.close()
            return
        threading.Thread(target=self._greet, args=(sock, address), name="rosplc-greet", daemon=True).start()

    def _greet(self, sock: socket.socket, address: tuple[str, int]) -> None:
        try:
            sock.settimeout(_TIMEOUT_S)
            header = read_header(sock, _TIMEOUT_S)
            topic = self._topics.outgoing().get(header.get("topic", ""))
            missing = [name for name in ("topic", "md5sum", "callerid") if name not in header]
            if missing:
                refusal = f"Missing required '{missing[0]}' field"
            elif topic is None:
                refusal = f"[{header['topic'][:256]}] is not published here"
            else:
                refusal = topic.accept(sock, address, header)
            if refusal:
                write_header(sock, {"error": refusal})
                sock.close()
        except (HandshakeError, OSError) as error:
            _logger.debug("a connection from %s came to nothing: %s", address, error)
            sock.close()
        except Exception:
            _logger.exception("a connection from %s had an error", address)
            sock.close()
        finally:
            self._greetings.release()

    def close(self) -> None:
        """Stop listening."""
        self._data.shutdown()
        self._rpc.close()
        for thread in self._threads:
            if thread is not threading.current_thread():
                thread.join(1.0)
