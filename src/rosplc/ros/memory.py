"""A ROS graph inside one process, for tests: the semantics of the others without a network.

Backends in one domain see each other. What DDS does, this does: newest ``depth`` messages
wait and older ones give way; latched publishers serve late subscribers; other types and
excluding settings keep endpoints from matching, and the status says so. Unlike DDS it looks
at no more of a payload than its header.
"""

from __future__ import annotations

import logging
import threading
from collections import deque
from typing import Any

from rosplc.ros._base import (
    BaseEndpoint,
    BaseNode,
    BasePublisher,
    BaseSubscription,
    Context,
    Opener,
    domain_number,
    graph_info,
    listed,
)
from rosplc.ros.backend import EndpointInfo, GraphInfo, OnMessage, Qos, incompatibility

__all__ = ["MemoryBackend", "MemoryPublisher", "MemorySubscription", "open_backend"]

_logger = logging.getLogger("rosplc.ros.memory")

_domains: dict[int, list[MemoryBackend]] = {}
_graph = threading.RLock()  # guards _domains and every list of endpoints: one small graph, one lock


class _Endpoint(BaseEndpoint):
    logger = _logger

    def __init__(self, backend: MemoryBackend, topic: str, type_name: str, type_hash: str, qos: Qos) -> None:
        super().__init__(topic, type_name, qos, backend.endpoints.remove, backend.clock)
        self.type_hash = type_hash
        self._backend = backend
        self._lock = _graph

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

    def _matched(self) -> int:
        with _graph:
            return sum(self.problem(other) is None for other in self._others())

    def _problem(self) -> tuple[str, str]:
        with _graph:
            others = self._others()
            problems = sorted(filter(None, (self.problem(other) for other in others)))
        if problems:
            return problems[0][0], listed(words for _, words in problems)
        if not others:
            return "", f"no node {'publishes' if self.direction == 'in' else 'subscribes to'} {self.topic}"
        return "", ""

    def close(self) -> None:
        """Leave the graph; closing twice is harmless."""
        with _graph:
            super().close()


class MemorySubscription(_Endpoint, BaseSubscription):
    """A topic being received; see :class:`rosplc.ros.backend.Subscription`."""

    def __init__(self, on_message: OnMessage, *arguments: Any) -> None:
        super().__init__(*arguments)
        self._on_message = on_message
        self._waiting: deque[tuple[bytes, int]] = deque()
        self._delivering = threading.RLock()

    def put(self, payload: bytes, stamp_ns: int) -> None:
        """Queue a message; the oldest one gives way. The graph's lock is held."""
        if len(self._waiting) == self.qos.depth:
            self._waiting.popleft()
            self._dropped += 1
        self._waiting.append((payload, stamp_ns))

    def deliver(self) -> None:
        """Hand over what waits; called by the receive thread alone."""
        with self._delivering:
            while not self.closed:
                with _graph:
                    if not self._waiting:
                        return
                    message = self._waiting.popleft()
                self._deliver(*message)

    def close(self) -> None:
        """Stop receiving; after the return no callback runs or starts."""
        super().close()
        with self._delivering:
            self._waiting.clear()


class MemoryPublisher(_Endpoint, BasePublisher):
    """A topic being sent; see :class:`rosplc.ros.backend.Publisher`."""

    def __init__(self, *arguments: Any) -> None:
        super().__init__(*arguments)
        latched = self.qos.depth if self.qos.durability == "transient_local" else 0
        self.kept: deque[tuple[bytes, int]] = deque(maxlen=latched)

    def write(self, payload: bytes, stamp_ns: int | None = None) -> bool:
        """Send one message; see :meth:`rosplc.ros.backend.Publisher.write`."""
        data = self._checked(payload)
        with _graph:
            if self.closed:
                raise self._closed()
            self._last_ns = self._clock.time_ns()
            message = (data, self._last_ns if stamp_ns is None else stamp_ns)
            self.kept.append(message)
            self._messages += 1
            for other in self._others():
                if isinstance(other, MemorySubscription) and self.problem(other) is None:
                    other.put(*message)
                    other._backend.wake()
        return True


class MemoryBackend(BaseNode):
    """One node of the graph in this process; see :class:`rosplc.ros.backend.Backend`."""

    name = "memory"
    capabilities = frozenset({"topics"})

    def __init__(self, context: Context) -> None:
        super().__init__(context, ros1=None)
        self.clock = context.clock
        self.domain = domain = domain_number(context.domain, context.environment) or 0
        self.endpoints: list[_Endpoint] = []
        self._lock = _graph
        self._news = threading.Event()
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
        full, name = self._resolve(topic, type_name)
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

    def _endpoints_now(self) -> list[_Endpoint]:
        return list(self.endpoints)

    def graph(self) -> GraphInfo:
        """Return what is seen of the other nodes."""
        with _graph:
            others = [backend for backend in _domains.get(self.domain, []) if backend is not self]
            seen = [(backend.node, endpoint) for backend in others for endpoint in backend.endpoints]
        return graph_info(
            (backend.node for backend in others),
            (EndpointInfo(e.topic, e.type_name, e.direction, node, e.qos, e.type_hash) for node, e in seen),
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
            endpoint.close()
        if threading.current_thread() is not self._thread:
            self._thread.join()


open_backend = Opener(MemoryBackend)
"""Connect to the graph of this process; arguments, without options, as :func:`rosplc.ros.open_backend`."""
