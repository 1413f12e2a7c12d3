"""The interface between the bridge and a ROS middleware; each backend implements it.

A backend transfers the bytes of messages without decoding them: CDR with its 4-byte encapsulation
header for ROS 2, ROS 1 serialization for ROS 1. To a ROS 2 backend, an action is three services and two
topics; to a ROS 1 backend, five topics.

Threads: every method may be called from any thread. ``on_message``, ``on_request`` and ``on_reply`` are
called from the backend's own threads, ``on_message`` one call at a time. They must not block. They may
close their own endpoint.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass, field
from typing import Any, Literal, Protocol

from rosplc.clock import SYSTEM, Clock
from rosplc.errors import BackendError
from rosplc.model import TypeStore
from rosplc.reasons import Reason

_STEADY_NS = 1_000_000_000
OnMessage = Callable[[bytes, int], None]
"""Called with a message's bytes and its source stamp (ns since 1970; the sender's clock)."""
OnRequest = Callable[[bytes, bytes, int], None]
"""Called with a request's bytes, its caller (16 bytes, for the reply) and its source stamp (0: unknown)."""


TypeSource = TypeStore
"""The former name of a parameter type."""

Reliability = Literal["reliable", "best_effort"]
Durability = Literal["volatile", "transient_local"]
History = Literal["keep_last"]

_MOST = 2**31 - 1  # DDS carries a depth as a signed 32-bit number


@dataclass(frozen=True, slots=True)
class Qos:
    """How messages of one topic are carried. Raises BackendError ROS007 for an invalid value."""

    reliability: Reliability = "reliable"  # repeats lost messages; ``best_effort`` does not
    # ``transient_local`` keeps the last ``depth`` messages for readers that come later (ROS 1: latched)
    durability: Durability = "volatile"
    depth: int = 10  # messages that wait at most; the oldest give way
    history: History = "keep_last"  # alone: a queue without a bound has no place beside a PLC
    # The longest time between two messages, and how long after its last sign of life ("automatic" liveliness)
    # a publisher counts as gone, as promised or asked for; 0: none. Only with the capability ``deadline``.
    deadline_ns: int = 0
    lease_ns: int = 0
    # How long a message is kept for late subscribers; 0: for ever. Over Zenoh, and in ROS 1, always.
    lifespan_ns: int = 0

    def __post_init__(self) -> None:
        for name, allowed in _ALLOWED.items():
            if (value := getattr(self, name)) not in allowed:
                raise BackendError("ROS007", f"{name} is {value!r}; it must be {' or '.join(allowed)}")
        if not isinstance(self.depth, int) or isinstance(self.depth, bool) or not 1 <= self.depth <= _MOST:
            raise BackendError("ROS007", f"depth is {self.depth!r}; it must be a positive integer")
        for name in ("deadline_ns", "lease_ns", "lifespan_ns"):
            time = getattr(self, name)
            if not isinstance(time, int) or isinstance(time, bool) or not 0 <= time < 2**63 - 1:
                raise BackendError("ROS007", f"{name} is {time!r}; use a positive integer (ns) or 0 for none")

    @property
    def promises(self) -> bool:
        """Whether a deadline or lease is promised or requested."""
        return bool(self.deadline_ns or self.lease_ns)


_ALLOWED: dict[str, tuple[str, ...]] = {
    "reliability": ("reliable", "best_effort"),
    "durability": ("volatile", "transient_local"),
    "history": ("keep_last",),
}

DEFAULT = Qos()
"""ROS 2's default for topics: reliable, volatile, the last 10 messages."""

SENSOR_DATA = Qos(reliability="best_effort", depth=5)
"""ROS 2's sensor data profile: the newest data matters, and losses are acceptable."""

LATCHED = Qos(durability="transient_local", depth=1000)
"""Like a latched ROS 1 publisher with a queue of 1000: late subscribers get earlier messages."""

SERVICES = Qos()
"""ROS 2's profile for services: reliable, volatile, the last 10 requests or responses."""

PRESETS: dict[str, Qos] = {"default": DEFAULT, "sensor_data": SENSOR_DATA, "latched": LATCHED}
"""Preset name, as a configuration writes it → settings."""


def incompatibility(offered: Qos, requested: Qos) -> str | None:
    """Return why an offered and a requested QoS do not match, or None if they do (DDS 1.4, 2.2.3)."""
    problems = []
    if offered.reliability == "best_effort" and requested.reliability == "reliable":
        problems.append("the publisher is best_effort and the subscriber requests reliable")
    if offered.durability == "volatile" and requested.durability == "transient_local":
        problems.append("the publisher is volatile and the subscriber requests transient_local")
    for what, offer, wish in (
        ("deadline", offered.deadline_ns, requested.deadline_ns),
        ("liveliness lease", offered.lease_ns, requested.lease_ns),
    ):
        if wish and not 0 < offer <= wish:
            has = f"a {what} of {offer / 1e6:g} ms" if offer else f"no {what}"
            problems.append(f"the publisher offers {has} and the subscriber requests {wish / 1e6:g} ms")
    return "; ".join(problems) or None


@dataclass(frozen=True, slots=True)
class EndpointStatus:
    """The current state of one of the bridge's own endpoints."""

    topic: str  # the absolute name of the topic or service, as ROS writes it
    type_name: str  # ``package/msg/Name``; ``package/srv/Name`` for a service
    direction: Literal["in", "out"]  # ``in``: a subscription or a server, ``out``: a publisher or a client
    matched: int = 0  # peers that exchange messages with it
    messages: int = 0  # messages, or requests, received or sent
    dropped: int = 0  # lost on the way: overrun queues, peers that could not keep up
    rejected: int = 0  # refused because their bytes do not fit the type
    failed: int = 0  # those that ``on_message`` raised an exception for
    last_ns: int = 0  # when the last one was received or sent (ns since 1970, own clock); 0: never
    reason: str = ""  # what keeps peers from matching, or what is doubtful; empty if all is well
    code: str = ""  # the error code that goes with ``reason``, if any
    late: int = 0  # times that a promised deadline passed without a message

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
    """Another node's endpoint, as shown by discovery."""

    topic: str  # the absolute topic name
    type_name: str  # ``package/msg/Name``
    direction: Literal["in", "out"]  # ``in`` if the peer subscribes, ``out`` if it publishes
    node: str  # the full name of its node; empty if it is not announced
    qos: Qos  # its settings; ``depth`` is not announced and is 1
    type_hash: str = ""  # the type hash that it announces; empty if none
    obstacles: tuple[str, ...] = ()  # in words, other settings that keep a plain ROS endpoint from matching


@dataclass(frozen=True, slots=True)
class GraphInfo:
    """The ROS graph as the backend sees it, without its own endpoints."""

    nodes: tuple[str, ...] = ()  # full names of the other nodes, sorted
    endpoints: tuple[EndpointInfo, ...] = ()  # the other nodes' endpoints
    topics: Mapping[str, tuple[str, ...]] = field(default_factory=dict)  # topic → types seen, sorted
    # The other nodes' ends, with the service's name and type: ``in`` for a server, ``out`` for a client.
    # ROS 1 knows no clients, and no types.
    services: tuple[EndpointInfo, ...] = ()


# What takes messages from C to C while it is open, ``_core/sink.h``; one that it does not take, or that comes
# after a silence that Python is to know of, closes it and is Python's. It has ``capsule``, ``messages``,
# ``last_ns`` and ``close()``. A backend that works in C has more than the protocols say: subscriptions with a
# method ``divert(sink)``, which gives a sink what it takes in place of ``on_message`` and returns whether it
# can, publishers with an attribute ``sink`` (or None) and a method ``open_sink(limit_ns)``.
Sink = Any


class Endpoint(Protocol):
    """The common interface of subscriptions, publishers, servers and clients."""

    topic: str
    """The absolute name of the topic or service."""
    type_name: str
    qos: Qos

    @property
    def matched(self) -> int:
        """Number of peers that exchange messages with it; for a server, the clients that can be answered."""

    def status(self) -> EndpointStatus:
        """Return the current state; cheap enough to be called every second."""

    def close(self) -> None:
        """Close the endpoint; after that, no callback runs, unless this was called from it. Callable twice.

        A client first ends every open call with ``fate unknown``.
        """


class Subscription(Endpoint, Protocol):
    """A subscription to a topic."""


class Publisher(Endpoint, Protocol):
    """A publisher of a topic."""

    def write(self, payload: bytes, stamp_ns: int | None = None) -> bool:
        """Send a serialized message, including its encapsulation header; never blocks.

        ``stamp_ns`` is the source stamp (ns since 1970; None: now). Return False if the message was dropped
        because a peer cannot keep up. Raises BackendError ROS008 if the payload is not a message of the type,
        ROS009 after close.
        """


@dataclass(frozen=True, slots=True)
class Reply:
    """How a call to a ROS server ended."""

    payload: bytes | None = None  # the serialized response; None if there is none
    # Without a response: ``not executed`` if the server never began, so that it is safe to call again;
    # ``fate unknown`` if it may have executed the request.
    outcome: Literal["not executed", "fate unknown"] = "fate unknown"
    reason: Reason = Reason.NONE  # why there is no response
    text: str = ""  # more about that, for the log; in ROS 1 the server's own words


OnReply = Callable[[Reply], None]
"""Called once with the end of a call."""


class ServiceServer(Endpoint, Protocol):
    """A service that ROS clients call."""

    @property
    def remembers(self) -> bool:
        """Whether a server of this service in another process can answer a caller by its 16-byte id."""

    def reply(self, caller: bytes, payload: bytes) -> bool:
        """Send the one response to a request received by ``on_request``; never blocks.

        Return False if the caller is gone, or was already answered or refused. Raises BackendError ROS008 if
        the payload, including its encapsulation header, is not a response of the type, ROS009 after close.
        """

    def refuse(self, caller: bytes, text: str) -> bool:
        """End a call without a response; see :meth:`reply`. ROS 1 clients get the text, others nothing."""

    def present(self, caller: bytes) -> bool:
        """Return whether a caller is still waiting; True if the middleware does not know."""


class ServiceClient(Endpoint, Protocol):
    """A client of a ROS service."""

    @property
    def ready(self) -> bool:
        """Whether a matching server, whose responses can be read, is known now."""

    def call(self, payload: bytes, on_reply: OnReply) -> int:
        """Send a request with its encapsulation header; never blocks. Return its number for :meth:`forget`.

        ``on_reply`` is called exactly once unless the call is forgotten, possibly before this method returns:
        with the response, ``not executed`` (such as reason ``NO_SERVER``: nothing was sent), or
        ``fate unknown`` (the server went offline; :meth:`close`). There is no time limit. Raises
        BackendError ROS008 if the payload is not a request of the type, ROS009 after close.
        """

    def forget(self, number: int) -> None:
        """Stop waiting for a call: ``on_reply`` is no longer called. An unknown number is ignored."""


class Backend(Protocol):
    """One ROS node on one middleware.

    A backend whose node can be ended from outside also has an attribute ``ended``: the reason as text,
    empty while the node is running (:func:`ended_for_good`). A backend may have a method ``changed``, which
    returns the endpoints that may have changed since the last call; without it, all may have changed.
    """

    name: str
    """The backend's name, as in ``ros.backend`` of the configuration."""

    capabilities: frozenset[str]
    """The supported features: ``topics``, ``services``; ``deadline`` means both deadlines and leases."""

    node: str
    """The node's full name."""

    def subscribe(self, topic: str, type_name: str, qos: Qos, on_message: OnMessage) -> Subscription:
        """Subscribe to a topic.

        Raises BackendError ROS005 for a bad name, ROS002 if the middleware refuses; MessageTypeError TYP001.
        """

    def advertise(self, topic: str, type_name: str, qos: Qos) -> Publisher:
        """Advertise a topic; raises as :meth:`subscribe`."""

    def serve(self, service: str, type_name: str, qos: Qos, on_request: OnRequest) -> ServiceServer:
        """Serve a service (capability ``services``); raises as :meth:`subscribe` does.

        ``type_name`` is ``package/srv/Name``, or a service of an action: ``package/action/Name_SendGoal``,
        ``package/action/Name_GetResult``. The message types have the suffixes ``_Request`` and ``_Response``.
        ``qos`` is :data:`SERVICES`, unless another depth is needed.
        """

    def client(self, service: str, type_name: str, qos: Qos) -> ServiceClient:
        """Call a service (capability ``services``); arguments and errors as for :meth:`serve`."""

    def status(self) -> tuple[EndpointStatus, ...]:
        """Return the state of all endpoints of this backend."""

    def graph(self) -> GraphInfo:
        """Return the graph of the other nodes."""

    def close(self) -> None:
        """Leave the graph: close all endpoints and end the receive thread; a second call does nothing."""


def ended_for_good(backend: Backend | None) -> str:
    """Return why a backend's node has left the graph permanently; empty if it has not."""
    return str(getattr(backend, "ended", ""))


def settled_graph(
    graph: Callable[[], GraphInfo], seconds: float, needed: Collection[str] = (), *, clock: Clock = SYSTEM
) -> GraphInfo:
    """Return the graph when it has been stable for 1 s and has the topics ``needed``, or at the limit."""
    # Discovery takes a moment, and nothing shows when it is over.
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
