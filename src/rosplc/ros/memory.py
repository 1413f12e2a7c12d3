"""A ROS graph inside one process, for tests: the semantics of the others without a network.

Backends in one domain see each other. What DDS does, this does: newest ``depth`` messages
wait and older ones give way; latched publishers serve late subscribers; other types and
excluding settings keep endpoints from matching, and the status says so. Unlike DDS it looks
at no more of a payload than its header.
"""

from __future__ import annotations

import logging
import os
import threading
import time
from collections import deque
from collections.abc import Mapping
from typing import Literal

from rosplc.errors import BackendError
from rosplc.ros.backend import (
    EndpointInfo,
    EndpointStatus,
    GraphInfo,
    OnMessage,
    Qos,
    TypeSource,
    incompatibility,
)
from rosplc.ros.names import resolve_topic, validate_namespace, validate_node_name
from rosplc.ros.words import listed

__all__ = ["MemoryBackend", "MemoryPublisher", "MemorySubscription", "open_backend"]

_logger = logging.getLogger("rosplc.ros.memory")

_domains: dict[int, list[MemoryBackend]] = {}
_graph = threading.RLock()  # guards _domains and every list of endpoints: one small graph, one lock


class _Endpoint:
    direction: Literal["in", "out"]

    def __init__(self, backend: MemoryBackend, topic: str, type_name: str, type_hash: str, qos: Qos) -> None:
        self.topic = topic
        self.type_name = type_name
        self.type_hash = type_hash
        self.qos = qos
        self._backend = backend
        self._closed = False
        self._messages = 0
        self._last_ns = 0

    def _others(self) -> list[_Endpoint]:
        """Endpoints of the other kind on the topic; ours on the same node too, as in ROS."""
        return [
            endpoint
            for backend in _domains.get(self._backend.domain, [])
            for endpoint in backend.endpoints
            if endpoint.topic == self.topic and endpoint.direction != self.direction
        ]

    def problem(self, other: _Endpoint) -> tuple[str, str] | None:
        """Return code and words for why two endpoints do not match, or None."""
        does = (
            f"node {other._backend.node} {'publishes' if other.direction == 'out' else 'subscribes to'}"
            f" {self.topic} as {other.type_name}"
        )
        if other.type_name != self.type_name:
            return "ROS003", f"{does}, here it is {self.type_name}"
        if other.type_hash != self.type_hash:
            return "ROS003", f"{does} with another definition"
        offered, requested = (other.qos, self.qos) if self.direction == "in" else (self.qos, other.qos)
        if (words := incompatibility(offered, requested)) is not None:
            return "ROS004", f"{does}, but {words}"
        return None

    @property
    def matched(self) -> int:
        """Peers that exchange messages with this endpoint."""
        with _graph:
            return 0 if self._closed else sum(self.problem(other) is None for other in self._others())

    def _reason(self) -> tuple[str, str]:
        if self._closed:
            return "ROS009", "closed"
        with _graph:
            others = self._others()
            problems = sorted(filter(None, (self.problem(other) for other in others)))
        if problems:
            return problems[0][0], listed(words for _, words in problems)
        if not others:
            return "", f"no node {'publishes' if self.direction == 'in' else 'subscribes to'} {self.topic}"
        return "", ""

    def _leave(self) -> bool:
        with _graph:
            if self._closed:
                return False
            self._closed = True
            self._backend.endpoints.remove(self)
            return True


class MemorySubscription(_Endpoint):
    """A topic being received; see :class:`rosplc.ros.backend.Subscription`."""

    direction: Literal["in"] = "in"

    def __init__(
        self,
        on_message: OnMessage,
        backend: MemoryBackend,
        topic: str,
        type_name: str,
        type_hash: str,
        qos: Qos,
    ) -> None:
        super().__init__(backend, topic, type_name, type_hash, qos)
        self._on_message = on_message
        self._waiting: deque[tuple[bytes, int]] = deque()
        self._delivering = threading.RLock()
        self._dropped = 0
        self._failed = 0

    def put(self, payload: bytes, stamp_ns: int) -> None:
        """Queue a message; the oldest one gives way. The graph's lock is held."""
        if len(self._waiting) == self.qos.depth:
            self._waiting.popleft()
            self._dropped += 1
        self._waiting.append((payload, stamp_ns))

    def deliver(self) -> None:
        """Hand over what waits; called by the receive thread alone."""
        with self._delivering:
            while not self._closed:
                with _graph:
                    if not self._waiting:
                        return
                    payload, stamp_ns = self._waiting.popleft()
                self._messages += 1
                self._last_ns = time.time_ns()
                try:
                    self._on_message(payload, stamp_ns)
                except Exception:
                    self._failed += 1
                    if self._failed == 1:
                        _logger.exception("%s: the receiver of its messages failed", self.topic)

    def status(self) -> EndpointStatus:
        """Return the present state."""
        code, reason = self._reason()
        return EndpointStatus(
            self.topic, self.type_name, "in", self.matched, self._messages, self._dropped,
            failed=self._failed, last_ns=self._last_ns, reason=reason, code=code,
        )  # fmt: skip

    def close(self) -> None:
        """Stop receiving; after the return no callback runs or starts."""
        self._leave()
        with self._delivering:
            self._waiting.clear()


class MemoryPublisher(_Endpoint):
    """A topic being sent; see :class:`rosplc.ros.backend.Publisher`."""

    direction: Literal["out"] = "out"

    def __init__(self, backend: MemoryBackend, topic: str, type_name: str, type_hash: str, qos: Qos) -> None:
        super().__init__(backend, topic, type_name, type_hash, qos)
        latched = qos.depth if qos.durability == "transient_local" else 0
        self.kept: deque[tuple[bytes, int]] = deque(maxlen=latched)
        self._rejected = 0

    def write(self, payload: bytes, stamp_ns: int | None = None) -> bool:
        """Send one message; see :meth:`rosplc.ros.backend.Publisher.write`."""
        if len(payload) < 4 or payload[0] != 0 or payload[1] > 1:
            self._rejected += 1
            raise BackendError(
                "ROS008",
                f"a message was not sent on {self.topic}: it has no header of plain CDR",
            )
        data = bytes(payload) + bytes(-len(payload) % 4)
        now = time.time_ns()
        with _graph:
            if self._closed:
                raise BackendError("ROS009", f"the publisher of {self.topic} is closed")
            message = (data, now if stamp_ns is None else stamp_ns)
            self.kept.append(message)
            self._messages += 1
            self._last_ns = now
            for other in self._others():
                if isinstance(other, MemorySubscription) and self.problem(other) is None:
                    other.put(*message)
                    other._backend.wake()
        return True

    def status(self) -> EndpointStatus:
        """Return the present state."""
        code, reason = self._reason()
        return EndpointStatus(
            self.topic, self.type_name, "out", self.matched, self._messages,
            rejected=self._rejected, last_ns=self._last_ns, reason=reason, code=code,
        )  # fmt: skip

    def close(self) -> None:
        """Stop sending; closing twice is harmless."""
        self._leave()


class MemoryBackend:
    """One node of the graph in this process; see :class:`rosplc.ros.backend.Backend`."""

    name = "memory"
    capabilities = frozenset({"topics"})

    def __init__(
        self, store: TypeSource, node_name: str, namespace: str, domain: int, remap: Mapping[str, str]
    ) -> None:
        self._store = store
        self._namespace = validate_namespace(namespace)
        self._node_name = validate_node_name(node_name)
        self._remap = dict(remap)
        self.node = f"{namespace.rstrip('/')}/{node_name}"
        self.domain = domain
        self.endpoints: list[_Endpoint] = []
        self._news = threading.Event()
        self._closed = False
        with _graph:
            _domains.setdefault(domain, []).append(self)
        self._thread = threading.Thread(target=self._run, name=f"rosplc-memory-{domain}", daemon=True)
        self._thread.start()

    def wake(self) -> None:
        """Tell the receive thread that messages wait."""
        self._news.set()

    def _run(self) -> None:
        while True:
            self._news.wait()
            self._news.clear()
            if self._closed:
                return
            with _graph:
                subscriptions = [e for e in self.endpoints if isinstance(e, MemorySubscription)]
            for subscription in subscriptions:
                subscription.deliver()

    def _names(self, topic: str, type_name: str) -> tuple[str, str, str]:
        if self._closed:
            raise BackendError("ROS009", f"node {self.node} has left the graph")
        full = resolve_topic(topic, namespace=self._namespace, node_name=self._node_name, remap=self._remap)
        name = self._store[type_name].name
        return full, name, self._store.type_hash(name)

    def subscribe(self, topic: str, type_name: str, qos: Qos, on_message: OnMessage) -> MemorySubscription:
        """Receive a topic; see :meth:`rosplc.ros.backend.Backend.subscribe`."""
        subscription = MemorySubscription(on_message, self, *self._names(topic, type_name), qos)
        with _graph:
            self.endpoints.append(subscription)
            if qos.durability == "transient_local":
                for other in subscription._others():
                    if isinstance(other, MemoryPublisher) and subscription.problem(other) is None:
                        # No loss: a subscriber with a smaller queue asks for fewer old messages.
                        for message in list(other.kept)[-qos.depth :]:
                            subscription.put(*message)
        self.wake()
        return subscription

    def advertise(self, topic: str, type_name: str, qos: Qos) -> MemoryPublisher:
        """Send a topic; see :meth:`rosplc.ros.backend.Backend.advertise`."""
        publisher = MemoryPublisher(self, *self._names(topic, type_name), qos)
        with _graph:
            self.endpoints.append(publisher)
        return publisher

    def status(self) -> tuple[EndpointStatus, ...]:
        """Return the state of all endpoints."""
        with _graph:
            endpoints = list(self.endpoints)
        return tuple(
            endpoint.status()
            for endpoint in endpoints
            if isinstance(endpoint, MemorySubscription | MemoryPublisher)
        )

    def graph(self) -> GraphInfo:
        """Return what is seen of the other nodes."""
        topics: dict[str, set[str]] = {}
        with _graph:
            others = [backend for backend in _domains.get(self.domain, []) if backend is not self]
            seen = [(backend.node, endpoint) for backend in others for endpoint in backend.endpoints]
        for _, endpoint in seen:
            topics.setdefault(endpoint.topic, set()).add(endpoint.type_name)
        infos = [
            EndpointInfo(e.topic, e.type_name, e.direction, node, e.qos, e.type_hash) for node, e in seen
        ]
        return GraphInfo(
            tuple(sorted({backend.node for backend in others})),
            tuple(sorted(infos, key=lambda info: (info.topic, info.direction, info.node))),
            {topic: tuple(sorted(kinds)) for topic, kinds in sorted(topics.items())},
        )

    def close(self) -> None:
        """Leave the graph; see :meth:`rosplc.ros.backend.Backend.close`."""
        with _graph:
            if self._closed:
                return
            self._closed = True
            _domains[self.domain].remove(self)
            if not _domains[self.domain]:
                del _domains[self.domain]
            endpoints = list(self.endpoints)
        self.wake()
        for endpoint in endpoints:
            if isinstance(endpoint, MemorySubscription | MemoryPublisher):
                endpoint.close()
        if threading.current_thread() is not self._thread:
            self._thread.join()


def open_backend(
    store: TypeSource,
    node_name: str,
    namespace: str = "/",
    domain: int | None = None,
    *,
    remap: Mapping[str, str] | None = None,
    environment: Mapping[str, str] | None = None,
    options: Mapping[str, object] | None = None,
) -> MemoryBackend:
    """Join the graph of this process; arguments, without options, as :func:`rosplc.ros.open_backend`."""
    variables = os.environ if environment is None else environment
    text = str(domain) if domain is not None else variables.get("ROS_DOMAIN_ID") or "0"
    if not text.isascii() or not text.isdigit() or len(text) > 9:
        raise BackendError(
            "ROS010", f"ROS_DOMAIN_ID is {text[:80]!r}; it is a number from 0 up", where="ROS_DOMAIN_ID"
        )
    return MemoryBackend(store, node_name, namespace, int(text), remap or {})
