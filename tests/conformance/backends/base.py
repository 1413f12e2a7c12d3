"""What the suite has to know of a backend: how to reach it, and what it honestly cannot do.

A harness stands for one ROS graph on one backend that nobody else uses. Each backend has a
module here with one class or more, named in ``registry.py``; the module imports no middleware
when it is imported, so that the flags can be read everywhere.
"""

from __future__ import annotations

import contextlib
import struct
from collections.abc import Callable
from dataclasses import dataclass, field, fields, replace
from typing import Any, ClassVar, Protocol, TypeVar

from rosplc.ros import EndpointStatus, GraphInfo, Qos
from tests.conformance.backends.child import RemoteInbox, RemoteNode, RemoteOutbox
from tests.conformance.backends.node import Inbox, Node, Opening, Outbox

STRING = "std_msgs/msg/String"

AnyNode = Node | RemoteNode
AnyInbox = Inbox | RemoteInbox
AnyOutbox = Outbox | RemoteOutbox
_N = TypeVar("_N", bound=AnyNode)


class PeerInbox(Protocol):
    """What an independent program has received."""

    def since(self, number: int) -> list[tuple[bytes, int]]:
        """Return the messages from the given one on, as the backend would give them, with stamps (or 0)."""


class PeerOutbox(Protocol):
    """What an independent program sends through."""

    def write(self, payload: bytes) -> object:
        """Send one message, given as the backend would take it."""


class Peer(Protocol):
    """An independent program on the same middleware: no code of rosplc between it and the network."""

    def subscribe(self, topic: str, type_name: str, qos: Qos) -> PeerInbox:
        """Receive a topic."""

    def advertise(self, topic: str, type_name: str, qos: Qos) -> PeerOutbox:
        """Send a topic."""

    def kill(self) -> None:
        """End its process without letting it say goodbye."""

    def close(self) -> None:
        """End it."""


def _flag(words: str) -> Any:
    return field(metadata={"words": words})


@dataclass(frozen=True)
class Abilities:
    """What differs between middlewares; ``docs/explanation/backends.md`` shows these as a table."""

    source_stamps: bool = _flag("a message carries a source timestamp that the sender can set")
    matches_qos: bool = _flag("reliability and durability must be compatible; if not, the reason is reported")
    latched_depth: bool = _flag("late subscribers get the last `depth` messages (if not, only the last one)")
    latched_by_publisher: bool = _flag(
        "the publisher alone decides whether late subscribers get old messages"
    )
    tells_definitions: bool = _flag("peers that define the message type differently are refused and reported")
    checks_outgoing: bool = _flag("a message whose bytes do not fit its type is refused before it is sent")
    checks_incoming: bool = _flag("a received message whose bytes do not fit its type is dropped and counted")
    counts_losses: bool = _flag("the counts of delivered and lost messages add up to the number sent")
    drops_on_full_links: bool = _flag(
        "if the link to a peer is full, even `reliable` messages are lost, and the sender is not notified"
    )
    shows_qos: bool = _flag("the QoS settings of other nodes' endpoints are visible")
    shows_hashes: bool = _flag("the type hashes of other nodes' endpoints are visible")
    many_nodes: bool = _flag("one process can contain several nodes")
    sees_callers: bool = _flag("a server detects that the caller of a service has exited")
    refuses_with_words: bool = _flag("if a service call is refused, the caller receives the reason")
    remembers_callers: bool = _flag("after a restart, a server can answer calls that it received before")
    has_hub: bool = _flag("nodes find each other through a master or router, which may restart")

    @classmethod
    def words(cls) -> dict[str, str]:
        """Return each flag with its meaning."""
        return {one.name: one.metadata["words"] for one in fields(cls)}


class Harness:
    """One graph on one backend; a context manager.

    Attributes:
        backend: The backend's name.
        title: What tests and documentation call it, if several harnesses share a backend.
        distros: The ROS distributions it is for; the first one serves unless a test asks for more.
        abilities: What the middleware can do.
        domain: The ROS domain, None where there are no domains.
        environment: What nodes get as their environment.
        options: What nodes get as the backend's own keys.
    """

    backend: ClassVar[str]
    title: ClassVar[str]
    distros: ClassVar[tuple[str, ...]] = ("jazzy", "humble", "kilted", "lyrical")
    abilities: ClassVar[Abilities]
    reaches_out: ClassVar[bool] = True
    """Whether nodes in different processes see each other: all middlewares, but not ``memory``."""
    real: ClassVar[bool] = False
    """Whether it runs over a real rclpy, in the environment that ``make ros2-env`` makes."""
    packages: ClassVar[tuple[str, ...]] = ()
    """The Debian packages it needs."""
    repeats: ClassVar[bool] = False
    """Whether most of what it shows another harness shows, too: then only ``make verify`` has it."""
    node_class: ClassVar[type[Node]] = Node
    """For backends whose nodes need more than :class:`Node` does; must be importable by name."""

    def __init__(self) -> None:
        self.domain: int | None = None
        self.environment: dict[str, str] = {}
        self.options: dict[str, object] = {}
        self._nodes: list[AnyNode] = []
        self.stack = contextlib.ExitStack()

    # -- what a backend's own harness defines

    @classmethod
    def missing(cls) -> str | None:
        """Return why this backend cannot be tested here, or None."""
        return None

    def start(self) -> None:
        """Take a domain, start a master or router …; ``self.stack`` undoes it."""

    def restart_hub(self, silent_s: float = 0.0) -> None:
        """Kill the master or router, wait, and start another one at the same place (``has_hub``)."""
        raise NotImplementedError

    def foreign_peers(self) -> tuple[str, ...]:
        """Return the names of independent peers, for :meth:`foreign`."""
        return ()

    def foreign(self, which: str, name: str) -> Peer:
        """Start an independent peer; pytest.skip with the missing package where there is one."""
        raise NotImplementedError

    def rogue(self, topic: str, type_name: str) -> Callable[[bytes], object] | None:
        """Return a function that puts any bytes on a topic, past all checks, or None if there is no way."""
        return None

    def bother(self, service: str, type_name: str) -> int:
        """Send a server what no client sends; return how much of it the server must count as rejected."""
        raise NotImplementedError

    # -- the same for all

    def __enter__(self) -> Harness:
        with contextlib.ExitStack() as stack:
            self.stack = stack
            self.start()
            self.stack = stack.pop_all()
        return self

    def __exit__(self, *_: object) -> None:
        try:
            for node in self._nodes:
                node.end()
        finally:
            self.stack.close()

    def opening(self, name: str, **different: Any) -> Opening:
        """Return how a node of this graph is opened."""
        usual = Opening(
            self.backend,
            name,
            self.distros[0],
            domain=self.domain,
            environment=self.environment,
            options=self.options,
        )
        return replace(usual, **different)

    def node(self, name: str, **different: Any) -> AnyNode:
        """Join with a node, in this process where the middleware allows it."""
        opening = self.opening(name, **different)
        return (
            self._add(self.node_class(opening))
            if self.abilities.many_nodes
            else self.process(name, **different)
        )

    def process(self, name: str, **different: Any) -> RemoteNode:
        """Join with a node in a process of its own."""
        return self._add(RemoteNode(self.opening(name, **different), self.node_class))

    def other(self, name: str, **different: Any) -> AnyNode:
        """Join with a node in another process, if the backend reaches beyond its own."""
        return self.process(name, **different) if self.reaches_out else self.node(name, **different)

    def _add(self, node: _N) -> _N:
        self._nodes.append(node)
        return node

    # -- messages on the wire

    @property
    def ros1(self) -> bool:
        """Whether messages are serialized as ROS 1 does it."""
        return self.distros[0] == "noetic"

    def string(self, text: str) -> bytes:
        """Return a serialized ``std_msgs/msg/String``."""
        data = text.encode()
        if self.ros1:
            return struct.pack("<I", len(data)) + data
        data += b"\0"
        return b"\0\1\0\0" + struct.pack("<I", len(data)) + data + bytes(-len(data) % 4)

    def text(self, payload: bytes) -> str:
        """Return the text of a serialized ``std_msgs/msg/String``."""
        if self.ros1:
            return payload[4:].decode()
        (length,) = struct.unpack_from("<I" if payload[1] else ">I", payload, 4)
        return payload[8 : 8 + length - 1].decode()

    def texts(self, inbox: AnyInbox | PeerInbox) -> list[str]:
        """Return the texts that an inbox holds."""
        return [self.text(payload) for payload, _ in inbox.since(0)]

    def find(self, statuses: tuple[EndpointStatus, ...], topic: str) -> EndpointStatus:
        """Return the status of one topic."""
        return next(status for status in statuses if status.topic == topic)

    def sees(self, graph: GraphInfo, topic: str) -> bool:
        """Return whether a topic is part of what a node sees."""
        return topic in graph.topics
