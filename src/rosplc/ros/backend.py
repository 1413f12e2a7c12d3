"""What the bridge asks of a ROS middleware; each backend is one implementation of it.

A backend moves a message's bytes and never looks inside: CDR for ROS 2 (with its 4-byte
encapsulation header), ROS 1 serialization for ROS 1. Topics only, for now; services and
actions will be further capabilities with methods of their own.

Threads: every method may be called from any thread. ``on_message`` is called from the
backend's own receive thread, one call at a time; it must not block. It may close its own
subscription.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass, field
from typing import Literal, Protocol

from rosplc.clock import SYSTEM, Clock
from rosplc.model.types import MessageType
from rosplc.ros.qos import DEFAULT, LATCHED, PRESETS, SENSOR_DATA, Qos, incompatibility

__all__ = [
    "DEFAULT",
    "LATCHED",
    "PRESETS",
    "SENSOR_DATA",
    "Backend",
    "EndpointInfo",
    "EndpointStatus",
    "GraphInfo",
    "OnMessage",
    "Publisher",
    "Qos",
    "Subscription",
    "TypeSource",
    "ended_for_good",
    "incompatibility",
    "settled_graph",
]

_STEADY_NS = 1_000_000_000
OnMessage = Callable[[bytes, int], None]
"""Called with a message's bytes and its source stamp (ns since 1970; the sender's clock)."""


class TypeSource(Protocol):
    """The part of a type store that backends use (:class:`rosplc.model.TypeStore` has it)."""

    @property
    def distro(self) -> str:
        """The ROS distribution, such as ``"jazzy"``."""

    def __getitem__(self, name: str) -> MessageType:
        """Return a type; TYP001 if it is unknown."""

    def type_hash(self, name: str) -> str:
        """Return the ROS 2 type hash, ``RIHS01_`` and 64 hex digits."""

    def md5(self, name: str) -> str:
        """Return the ROS 1 MD5 sum, 32 hex digits."""

    def definition_text(self, name: str) -> str:
        """Return the definition with every type it needs, as ROS 1 puts it into connection headers."""


@dataclass(frozen=True, slots=True)
class EndpointStatus:
    """One of the bridge's own endpoints, as it stands.

    Attributes:
        topic: The absolute topic name, as ROS writes it.
        type_name: ``package/msg/Name``.
        direction: ``in`` for a subscription, ``out`` for a publisher.
        matched: Peers that exchange messages with this endpoint.
        messages: Messages received or sent.
        dropped: Messages lost on the way: overrun queues, peers that could not keep up.
        rejected: Messages refused because their bytes do not fit the type.
        failed: Messages that ``on_message`` raised an exception for.
        last_ns: When the last message was received or sent (ns since 1970, own clock); 0: never.
        reason: In words, what keeps peers from matching, or what is doubtful; empty if all is well.
        code: The error code that goes with ``reason``; empty if there is none.
        late: Times that a promised deadline passed without a message; 0 where none was promised.
    """

    topic: str
    type_name: str
    direction: Literal["in", "out"]
    matched: int = 0
    messages: int = 0
    dropped: int = 0
    rejected: int = 0
    failed: int = 0
    last_ns: int = 0
    reason: str = ""
    code: str = ""
    late: int = 0

    @property
    def received(self) -> int:
        """Messages received; 0 for a publisher."""
        return self.messages if self.direction == "in" else 0

    @property
    def sent(self) -> int:
        """Messages sent; 0 for a subscription."""
        return self.messages if self.direction == "out" else 0


@dataclass(frozen=True, slots=True)
class EndpointInfo:
    """A peer's endpoint as discovery shows it.

    Attributes:
        topic: The absolute topic name.
        type_name: ``package/msg/Name``.
        direction: ``in`` if the peer subscribes, ``out`` if it publishes.
        node: The full name of its node; empty if the peer does not say.
        qos: Its settings; ``depth`` is not announced and stands at 1.
        type_hash: The type hash it announces; empty if none.
        obstacles: Its other settings that keep a plain ROS endpoint from matching, in words.
    """

    topic: str
    type_name: str
    direction: Literal["in", "out"]
    node: str
    qos: Qos
    type_hash: str = ""
    obstacles: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class GraphInfo:
    """What the backend sees of the ROS graph, its own endpoints left out.

    Attributes:
        nodes: Full names of the other nodes, sorted.
        endpoints: The other nodes' endpoints.
        topics: Topic name → types seen on it, sorted.
    """

    nodes: tuple[str, ...] = ()
    endpoints: tuple[EndpointInfo, ...] = ()
    topics: Mapping[str, tuple[str, ...]] = field(default_factory=dict)


class Subscription(Protocol):
    """A topic that is being received."""

    topic: str
    type_name: str
    qos: Qos

    @property
    def matched(self) -> int:
        """Publishers that this subscription receives from."""

    def status(self) -> EndpointStatus:
        """Return the present state; cheap enough to be asked every second."""

    def close(self) -> None:
        """Stop receiving; after the return no callback runs or starts (unless called from it)."""


class Publisher(Protocol):
    """A topic that is being sent."""

    topic: str
    type_name: str
    qos: Qos

    @property
    def matched(self) -> int:
        """Subscribers that this publisher sends to."""

    def write(self, payload: bytes, stamp_ns: int | None = None) -> bool:
        """Send one message.

        Args:
            payload: The serialized message, its encapsulation header included.
            stamp_ns: The source stamp (ns since 1970); None: now.

        Returns:
            False if the message was dropped because a peer does not keep up; never blocks.

        Raises:
            BackendError: ROS008 if the payload is no message of the type, ROS009 after close.
        """

    def status(self) -> EndpointStatus:
        """Return the present state; cheap enough to be asked every second."""

    def close(self) -> None:
        """Stop sending; closing twice is harmless."""


class Backend(Protocol):
    """One ROS node on one middleware.

    A backend whose node can be ended from outside has an attribute ``ended`` as well: why, in words;
    empty while it lives (:func:`ended_for_good`).
    """

    name: str
    """The backend's name, as ``ros.backend`` in the configuration has it."""

    capabilities: frozenset[str]
    """What it can carry: ``topics``, and ``deadline`` if it keeps what a QoS promises in time."""

    def subscribe(self, topic: str, type_name: str, qos: Qos, on_message: OnMessage) -> Subscription:
        """Receive a topic.

        Raises:
            BackendError: ROS005 for a bad name, ROS002 if the middleware refuses.
            MessageTypeError: TYP001 if the type is unknown.
        """

    def advertise(self, topic: str, type_name: str, qos: Qos) -> Publisher:
        """Send a topic; raises as :meth:`subscribe` does."""

    def status(self) -> tuple[EndpointStatus, ...]:
        """Return the state of all endpoints of this backend."""

    def graph(self) -> GraphInfo:
        """Return what is seen of the other nodes."""

    def close(self) -> None:
        """Leave the graph: close all endpoints, end the receive thread; harmless twice."""


def ended_for_good(backend: Backend | None) -> str:
    """Return why a backend's node has left the graph for good; empty if it has not, or never does."""
    return str(getattr(backend, "ended", ""))


def settled_graph(
    graph: Callable[[], GraphInfo], seconds: float, needed: Collection[str] = (), *, clock: Clock = SYSTEM
) -> GraphInfo:
    """Return the graph once it has not changed for a second, or when the time is over.

    Discovery takes a moment, and nothing shows when it is over.

    Args:
        graph: :meth:`rosplc.ros.backend.Backend.graph`.
        seconds: The longest time.
        needed: Topics that are waited for.
        clock: Time.
    """
    start = changed = clock.monotonic_ns()
    seen = graph()
    while (now := clock.monotonic_ns()) - start < seconds * 1e9:
        clock.sleep(100_000_000)
        if (again := graph()) != seen:
            seen, changed = again, now
        # A graph without other nodes may still be about to appear: it is waited for to the end.
        complete = bool(seen.nodes) and all(end.node for end in seen.endpoints)
        complete = complete and all(topic in seen.topics for topic in needed)
        if complete and min(now - start, now - changed) > _STEADY_NS:
            break
    return seen
