"""What the backends share: a node's names, an endpoint's counts and delivery, how a node is opened."""

from __future__ import annotations

import logging
import os
import threading
from collections.abc import Callable, Hashable, Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any, Generic, Literal, TypeVar

from rosplc.clock import SYSTEM, Clock
from rosplc.errors import BackendError
from rosplc.harmless import one_line
from rosplc.ros.backend import EndpointInfo, EndpointStatus, GraphInfo, OnMessage, Qos, TypeSource
from rosplc.ros.names import join, resolve_topic, validate_namespace, validate_node_name

__all__ = [
    "LONGEST_REASON",
    "MOST_REASONS",
    "MOST_REMEMBERED",
    "BaseEndpoint",
    "BaseNode",
    "BasePublisher",
    "BaseSubscription",
    "Context",
    "LogOnce",
    "Opener",
    "check_ros",
    "domain_number",
    "graph_info",
    "is_cdr",
    "listed",
]

MOST_REASONS = 8
"""Peers of one topic that a reason names; the others are counted."""
LONGEST_REASON = 500
"""Characters about one peer."""
MOST_REMEMBERED = 1000
"""Reasons that a backend remembers to have logged; further ones are not logged."""

_PADDING = (b"", b"\0", b"\0\0", b"\0\0\0")

_B = TypeVar("_B")


@dataclass(frozen=True)
class Context:
    """What a node is opened with; see :func:`rosplc.ros.open_backend`."""

    store: TypeSource
    node_name: str
    namespace: str = "/"
    domain: int | None = None
    remap: Mapping[str, str] = field(default_factory=dict)
    environment: Mapping[str, str] = field(default_factory=lambda: os.environ)
    options: Mapping[str, object] = field(default_factory=dict)
    clock: Clock = SYSTEM


class Opener(Generic[_B]):
    """A backend module's ``open_backend``; its arguments are those of :func:`rosplc.ros.open_backend`."""

    def __init__(self, make: Callable[[Context], _B]) -> None:
        self._make = make

    def __call__(
        self,
        store: TypeSource,
        node_name: str,
        namespace: str = "/",
        domain: int | None = None,
        *,
        remap: Mapping[str, str] | None = None,
        environment: Mapping[str, str] | None = None,
        options: Mapping[str, object] | None = None,
        clock: Clock = SYSTEM,
    ) -> _B:
        """Open the node."""
        variables = os.environ if environment is None else environment
        return self._make(
            Context(store, node_name, namespace, domain, remap or {}, variables, options or {}, clock)
        )


def domain_number(domain: int | None, environment: Mapping[str, str], most: int | None = None) -> int | None:
    """Return the ROS domain: the given one, else ``ROS_DOMAIN_ID``, else None.

    Raises:
        BackendError: ROS010 if it is no number from 0 to ``most``.
    """
    source = "ros.domain" if domain is not None else "ROS_DOMAIN_ID"
    text = str(domain) if domain is not None else environment.get("ROS_DOMAIN_ID") or ""
    if not text:
        return None
    if not text.isascii() or not text.isdigit() or len(text) > 9 or (most is not None and int(text) > most):
        to = "up" if most is None else f"to {most}"
        raise BackendError("ROS010", f"{source} is {text[:80]!r}; it is a number from 0 {to}", where=source)
    return int(text)


def listed(texts: Iterable[str]) -> str:
    """Return what is wrong with several peers as one line of bounded length: names are theirs."""
    unique = list(dict.fromkeys(texts))
    lines = map(one_line, unique[:MOST_REASONS])
    shown = [line if len(line) <= LONGEST_REASON else f"{line[: LONGEST_REASON - 1]}…" for line in lines]
    if len(unique) > MOST_REASONS:
        shown.append(f"and {len(unique) - MOST_REASONS} more")
    return "; ".join(shown)


class LogOnce:
    """What has been logged already; a graph that makes up names fills neither memory nor log."""

    def __init__(self) -> None:
        self._known: set[Hashable] = set()

    def first(self, what: Hashable) -> bool:
        """Return whether this is to be logged now."""
        if what in self._known or len(self._known) >= MOST_REMEMBERED:
            return False
        self._known.add(what)
        return True


def graph_info(nodes: Iterable[str], endpoints: Iterable[EndpointInfo]) -> GraphInfo:
    """Return the graph of these nodes and endpoints, sorted."""
    found = sorted(endpoints, key=lambda info: (info.topic, info.direction, info.node))
    topics: dict[str, set[str]] = {}
    for one in found:
        topics.setdefault(one.topic, set()).add(one.type_name)
    return GraphInfo(
        tuple(sorted(set(nodes))),
        tuple(found),
        {topic: tuple(sorted(each)) for topic, each in topics.items()},
    )


def is_cdr(payload: bytes) -> bool:
    """Return whether bytes begin with the header of plain CDR."""
    return len(payload) >= 4 and payload[0] == 0 and payload[1] <= 1


class BaseEndpoint:
    """An endpoint's counts and its end.

    Args:
        topic: The absolute topic name.
        type_name: ``package/msg/Name``.
        qos: The settings.
        on_close: Called once, with the endpoint.
        clock: Time.
    """

    direction: Literal["in", "out"]
    logger = logging.getLogger("rosplc.ros")

    def __init__(
        self, topic: str, type_name: str, qos: Qos, on_close: Callable[[Any], None], clock: Clock = SYSTEM
    ) -> None:
        self.topic = topic
        self.type_name = type_name
        self.qos = qos
        self.closed = False
        self._on_close = on_close
        self._clock = clock
        self._lock = threading.RLock()  # re-entrant: on_message may close its own subscription
        self._messages = self._dropped = self._rejected = self._failed = self._last_ns = 0

    @property
    def matched(self) -> int:
        """Peers that exchange messages with this endpoint."""
        return 0 if self.closed else self._matched()

    def _matched(self) -> int:
        raise NotImplementedError

    def _problem(self) -> tuple[str, str]:
        """Return code and words for what keeps peers from matching; empty if all is well."""
        raise NotImplementedError

    def _losses(self) -> int:
        """Return messages that the middleware lost on the way, as far as it tells."""
        return 0

    def _late(self) -> int:
        """Return how often a promised deadline passed without a message."""
        return 0

    def status(self) -> EndpointStatus:
        """Return the present state."""
        if self.closed:
            matched, code, reason, losses, late = 0, "ROS009", "closed", 0, 0
        else:
            code, reason = self._problem()
            matched, losses, late = self.matched, self._losses(), self._late()
        return EndpointStatus(
            self.topic, self.type_name, self.direction, matched, self._messages, self._dropped + losses,
            self._rejected, self._failed, self._last_ns, reason, code, late,
        )  # fmt: skip

    def close(self) -> None:
        """Stop sending or receiving; closing twice is harmless."""
        with self._lock:
            if self.closed:
                return
            self.closed = True
        self._on_close(self)


class BaseSubscription(BaseEndpoint):
    """A topic being received; see :class:`rosplc.ros.backend.Subscription`."""

    direction: Literal["in"] = "in"
    _on_message: OnMessage

    def _deliver(self, payload: bytes, stamp_ns: int) -> None:
        """Hand over one message, and count it; nothing that the receiver raises escapes."""
        self._messages += 1
        self._last_ns = self._clock.time_ns()
        try:
            self._on_message(payload, stamp_ns or self._last_ns)
        except Exception:
            self._failed += 1
            if self._failed == 1:
                self.logger.exception("%s: the receiver of its messages failed", self.topic)

    def refuse(self, error: object) -> None:
        """Count a message that no ROS node sends."""
        with self._lock:
            self._rejected += 1
            first = self._rejected == 1
        level = logging.WARNING if first else logging.DEBUG
        self.logger.log(level, "%s: a message was refused: %s", self.topic, error)

    def _refused(self) -> str:
        return (
            f"{self._rejected} messages on {self.topic} were none that a ROS 2 node sends"
            if self._rejected
            else ""
        )


class BasePublisher(BaseEndpoint):
    """A topic being sent; see :class:`rosplc.ros.backend.Publisher`."""

    direction: Literal["out"] = "out"

    def _checked(self, payload: bytes) -> bytes:
        """Return a message padded to whole words; ROS008 if it has no header of plain CDR."""
        if not is_cdr(payload):
            raise self._refusal("it has no header of plain CDR")
        return bytes(payload) + _PADDING[-len(payload) & 3]

    def _refusal(self, why: str) -> BackendError:
        with self._lock:
            self._rejected += 1
        return BackendError("ROS008", f"a message was not sent on {self.topic}: {why}")

    def _closed(self) -> BackendError:
        return BackendError("ROS009", f"the publisher of {self.topic} is closed")


class BaseNode:
    """A node's names and types.

    Args:
        context: What it is opened with.
        ros1: Whether the backend is one of ROS 1; None: it takes the types of both.

    Raises:
        BackendError: ROS001 if the types are those of the other ROS, ROS005 for a bad name.
    """

    name: str
    logger = logging.getLogger("rosplc.ros")

    def __init__(self, context: Context, *, ros1: bool | None = False) -> None:
        if ros1 is not None:
            check_ros(self.name, context.store, ros1=ros1)
        self._namespace = validate_namespace(context.namespace)
        self._node_name = validate_node_name(context.node_name)
        self.node = join(context.namespace, context.node_name)
        self._remap = dict(context.remap)
        self._store = context.store
        self._clock = context.clock
        self._lock = threading.RLock()
        self._closed = False
        self._logged = LogOnce()

    def _resolve(self, topic: str, type_name: str) -> tuple[str, str]:
        """Return the full names of topic and type.

        Raises:
            BackendError: ROS009 after :meth:`close`, ROS005 for a bad name.
            MessageTypeError: TYP001 for an unknown type.
        """
        self._usable()
        full = resolve_topic(topic, namespace=self._namespace, node_name=self._node_name, remap=self._remap)
        return full, self._store[type_name].name

    def _usable(self) -> None:
        if self._closed:
            raise BackendError("ROS009", f"node {self.node} has left the graph")

    def _endpoints_now(self) -> list[Any]:
        raise NotImplementedError

    def status(self) -> tuple[EndpointStatus, ...]:
        """Return the state of all endpoints."""
        with self._lock:
            endpoints = self._endpoints_now()
        return tuple(endpoint.status() for endpoint in endpoints)


def check_ros(name: str, store: TypeSource, *, ros1: bool = False) -> None:
    """Refuse (ROS001) types of the other ROS."""
    if (store.distro == "noetic") is ros1:
        return
    if ros1:
        what = f"the {name} backend speaks ROS 1; {store.distro or 'this type store'} is ROS 2"
        raise BackendError("ROS001", what, remedy="Set ros.distro to noetic.")
    raise BackendError(
        "ROS001", f"the {name} backend speaks ROS 2; noetic is ROS 1", remedy="Set ros.distro."
    )
