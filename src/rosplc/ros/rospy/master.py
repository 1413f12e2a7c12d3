"""Calls to the master and to other nodes, each bounded in time (http://wiki.ros.org/ROS/Master_API)."""

from __future__ import annotations

import http.client
import ipaddress
import socket
import xmlrpc.client
from collections.abc import Iterable, Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from typing import Any
from urllib.parse import urlsplit
from xml.parsers.expat import ExpatError

from rosplc.clock import SYSTEM, Clock
from rosplc.errors import BackendError

DEFAULT_MASTER = "http://localhost:11311"


@dataclass(frozen=True, slots=True)
class Address:
    """The addresses by which a node finds the graph and is found."""

    master: str  # the master's URI
    host: str  # the host name or address that other nodes are told
    bind: str  # the address to listen on; everything but a loopback ``host`` listens everywhere


def place_of(uri: object, scheme: str = "http") -> tuple[str, int] | None:
    """Return host and port of ``http://host:port``, with or without a final slash; otherwise None."""
    with suppress(ValueError):
        parts = urlsplit(uri) if isinstance(uri, str) and len(uri) <= 1024 else None
        if parts is not None and parts.scheme == scheme and parts.hostname and parts.port:
            return parts.hostname, parts.port
    return None


def is_node_uri(uri: object) -> bool:
    """Return whether this is the URI of a node's or master's interface."""
    return place_of(uri) is not None


def read_address(environment: Mapping[str, str]) -> Address:
    """Read ``ROS_MASTER_URI``, ``ROS_HOSTNAME`` and ``ROS_IP``; ROS010 if one of them is not valid."""
    master = environment.get("ROS_MASTER_URI") or DEFAULT_MASTER
    if not is_node_uri(master):
        raise _wrong("ROS_MASTER_URI", master, f"an address such as {DEFAULT_MASTER}")
    if environment.get("ROS_IPV6") == "on":
        raise _wrong("ROS_IPV6", "on", "off or unset: this backend uses IPv4")
    host = _host(environment)
    local = host == "localhost" or host.startswith("127.")
    return Address(master, host, ("127.0.0.1" if host == "localhost" else host) if local else "")


def _host(environment: Mapping[str, str]) -> str:
    if "ROS_HOSTNAME" in environment:
        name = environment["ROS_HOSTNAME"]
        if not name or any(sign in name for sign in ":/ "):
            raise _wrong("ROS_HOSTNAME", name, "a host name without protocol and port")
        return name
    if "ROS_IP" in environment:
        text = environment["ROS_IP"]
        try:
            return str(ipaddress.IPv4Address(text))
        except ValueError:
            raise _wrong("ROS_IP", text, "an IPv4 address such as 192.168.1.10") from None
    name = socket.gethostname()
    return name if name and name != "localhost" and not name.startswith("127.") else "127.0.0.1"


def _wrong(variable: str, value: str, right: str) -> BackendError:
    return BackendError("ROS010", f"{variable} is {value!r}; it must be {right}", where=variable)


MOST_ANSWER = 16 << 20  # Bytes of an answer; the state of a graph of thousands of nodes has less.

_TIMEOUT_S = 3.0
_LONGEST = 10  # times the timeout for all of an answer: one that drips in must not hold us for ever


class UnreachableError(Exception):
    """No valid ROS response was received; the text shows what happened."""


class RefusedError(Exception):
    """The other side refused the request."""


class _Transport(xmlrpc.client.Transport):
    """Unlike the standard transport, limits time and size, and does not accept compressed responses."""

    accept_gzip_encoding = False  # a few bytes would become any number of them

    def __init__(self, timeout_s: float, clock: Clock) -> None:
        super().__init__()
        self._timeout_s, self._clock = timeout_s, clock

    def make_connection(self, host: Any) -> http.client.HTTPConnection:
        connection = super().make_connection(host)
        connection.timeout = self._timeout_s
        return connection

    def parse_response(self, response: Any) -> Any:
        """Read a response; ValueError or OSError if it is invalid, too large or too slow."""
        if response.getheader("Content-Encoding", "identity") != "identity":
            raise ValueError("it is compressed, which was not requested")
        deadline_ns = self._clock.monotonic_ns() + round(_LONGEST * self._timeout_s * 1e9)
        parser, target = self.getparser()
        size = 0
        while data := response.read1(65536):
            size += len(data)
            if size > MOST_ANSWER:
                raise ValueError(f"it has more than {MOST_ANSWER} bytes")
            if self._clock.monotonic_ns() > deadline_ns:
                raise TimeoutError("it took too long")
            parser.feed(data)
        response.close()  # read1() does not tell the connection that all has been read
        parser.close()
        return target.close()


def proxy(uri: str, timeout_s: float = _TIMEOUT_S, clock: Clock = SYSTEM) -> xmlrpc.client.ServerProxy:
    """Return a proxy for one thread; its calls end after ``timeout_s`` seconds without new data."""
    return xmlrpc.client.ServerProxy(uri, transport=_Transport(timeout_s, clock))


def call(server: xmlrpc.client.ServerProxy, method: str, *arguments: Any) -> Any:
    """Call a method of ROS's API and return its value.

    Raises UnreachableError without a valid response, RefusedError for a code other than 1.
    """
    try:
        code, text, value = getattr(server, method)(*arguments)
    except (OSError, http.client.HTTPException) as error:
        why = getattr(error, "strerror", None) or str(error) or type(error).__name__
        raise UnreachableError(why) from error
    except (xmlrpc.client.Error, ExpatError, ValueError, TypeError) as error:
        raise UnreachableError(f"invalid response: {error}") from error
    if code != 1:
        raise RefusedError(str(text))
    return value


@dataclass(frozen=True, slots=True)
class SystemState:
    """The state of the master."""

    # topic → names of the nodes that publish it
    publishers: dict[str, frozenset[str]] = field(default_factory=dict)
    # topic → names of the nodes that subscribe to it
    subscribers: dict[str, frozenset[str]] = field(default_factory=dict)
    # service → names of the nodes that serve it: one, or none
    services: dict[str, frozenset[str]] = field(default_factory=dict)
    nodes: frozenset[str] = frozenset()  # the names of all nodes
    # topic → type as ROS 1 writes it; ``*`` where nobody has said
    types: dict[str, str] = field(default_factory=dict)


class Master:
    """The master as seen by the node ``caller``; for use by one thread."""

    def __init__(self, uri: str, caller: str, timeout_s: float = _TIMEOUT_S, clock: Clock = SYSTEM) -> None:
        self.uri = uri
        self._caller = caller
        self._server = proxy(uri, timeout_s, clock)

    def call(self, method: str, *arguments: Any) -> Any:
        """Call one of its methods; raises as :func:`call`."""
        return call(self._server, method, self._caller, *arguments)

    def service_place(self, service: str) -> tuple[str, int]:
        """Return host and port of a service's server. Raises RefusedError if there is no server."""
        uri = self.call("lookupService", service)
        if (place := place_of(uri, "rosrpc")) is None:
            raise UnreachableError(f"invalid response: {str(uri)[:200]}")
        return place

    def node_uri(self, node: str) -> str:
        """Return a node's URI; empty if the master does not know it."""
        try:
            return str(self.call("lookupNode", node))
        except RefusedError:
            return ""

    def setting(self, name: str) -> object:
        """Return a parameter of the parameter server; None if it is not set."""
        try:
            return self.call("getParam", name)
        except RefusedError:
            return None

    def state(self, known: SystemState | None = None) -> SystemState:
        """Return the state of the master; types are requested only if it differs from ``known``."""
        try:
            publishers, subscribers, services = (_table(part) for part in self.call("getSystemState"))
            nodes = frozenset().union(*publishers.values(), *subscribers.values(), *services.values())
            if known and (publishers, subscribers) == (known.publishers, known.subscribers):
                types = known.types
            else:
                types = {str(topic): str(kind) for topic, kind in self.call("getTopicTypes")}
        except (TypeError, ValueError) as error:
            raise UnreachableError(f"invalid response: {error}") from error
        return SystemState(publishers, subscribers, services, nodes, types)

    def close(self) -> None:
        """Close the connection."""
        self._server("close")()


def _table(rows: Iterable[Any]) -> dict[str, frozenset[str]]:
    return {str(name): frozenset(map(str, nodes)) for name, nodes in rows}
