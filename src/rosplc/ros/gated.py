"""A backend whose endpoints exist only while it is active: the ROS side of a lifecycle node.

A managed node that is inactive neither hears nor says anything. Endpoints that were asked for are
remembered, opened by :meth:`GatedBackend.activate` and closed by :meth:`GatedBackend.deactivate`;
a latched topic's last messages come again with each activation, as for any late subscriber.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Collection
from dataclasses import replace
from typing import Generic, Literal, TypeVar

from rosplc.errors import BackendError
from rosplc.ros.backend import (
    Backend,
    EndpointStatus,
    GraphInfo,
    OnMessage,
    Publisher,
    Qos,
    Subscription,
    ended_for_good,
)

__all__ = ["GatedBackend", "GatedPublisher", "GatedSubscription"]

_INACTIVE = "the node is not active"

_E = TypeVar("_E", bound=Subscription | Publisher)


class _Gated(Generic[_E]):
    direction: Literal["in", "out"]

    def __init__(
        self,
        topic: str,
        type_name: str,
        qos: Qos,
        make: Callable[[], _E],
        forget: Callable[[_Gated[_E]], None],
    ) -> None:
        self.topic = topic
        self.type_name = type_name
        self.qos = qos
        self._make = make
        self._forget = forget
        self._before = EndpointStatus(topic, type_name, self.direction)
        self.inner: _E | None = None
        self.closed = False

    @property
    def matched(self) -> int:
        """Peers of the open endpoint."""
        inner = self.inner
        return 0 if inner is None else inner.matched

    def open(self) -> None:
        """Open the endpoint; raises as the backend does."""
        if self.inner is None:
            self.inner = self._make()
            self.topic = self.inner.topic

    def shut(self) -> None:
        """Close the endpoint, and keep its counts."""
        inner, self.inner = self.inner, None
        if inner is not None:
            inner.close()
            self._before = self._sum(inner.status())

    def _sum(self, now: EndpointStatus) -> EndpointStatus:
        then = self._before
        return replace(
            now,
            messages=then.messages + now.messages,
            dropped=then.dropped + now.dropped,
            rejected=then.rejected + now.rejected,
            failed=then.failed + now.failed,
            last_ns=now.last_ns or then.last_ns,
        )

    def status(self) -> EndpointStatus:
        """Return the present state; the counts are those of all activations together."""
        inner = self.inner
        if inner is not None:
            return self._sum(inner.status())
        code, reason = ("ROS009", "closed") if self.closed else ("", _INACTIVE)
        return replace(self._before, topic=self.topic, matched=0, code=code, reason=reason)

    def close(self) -> None:
        """Close it for good; closing twice is harmless."""
        if not self.closed:
            self.closed = True
            self.shut()
            self._forget(self)


class GatedSubscription(_Gated[Subscription]):
    """A topic that is received while the backend is active."""

    direction: Literal["in"] = "in"


class GatedPublisher(_Gated[Publisher]):
    """A topic that is sent while the backend is active."""

    direction: Literal["out"] = "out"

    def write(self, payload: bytes, stamp_ns: int | None = None) -> bool:
        """Send one message.

        Raises:
            BackendError: ROS009 while the backend is inactive, and as the backend's own publisher.
        """
        inner = self.inner
        if inner is None:
            raise BackendError("ROS009", "closed" if self.closed else _INACTIVE, where=self.topic)
        return inner.write(payload, stamp_ns)


class GatedBackend:
    """A backend behind a gate; see :class:`rosplc.ros.backend.Backend`.

    Args:
        inner: The backend; closed by :meth:`close`.
        check: Called with the type's name when an endpoint is asked for, to refuse at once what
            could not be opened later.
        always: Topics that the gate does not hold back.

    Attributes:
        active: Whether the gate is open; it is closed at first.
        check: As given.
    """

    def __init__(
        self,
        inner: Backend,
        check: Callable[[str], None] = lambda _: None,
        always: Collection[str] = ("/diagnostics",),
    ) -> None:
        self.name = inner.name
        self.capabilities = inner.capabilities
        self.active = False
        self._inner = inner
        self.check = check
        self._always = frozenset(always)
        self._lock = threading.RLock()
        self._endpoints: list[GatedSubscription | GatedPublisher] = []

    def subscribe(self, topic: str, type_name: str, qos: Qos, on_message: OnMessage) -> Subscription:
        """Receive a topic while active; see :meth:`rosplc.ros.backend.Backend.subscribe`."""
        inner = self._inner
        if topic in self._always:
            return inner.subscribe(topic, type_name, qos, on_message)
        subscription = GatedSubscription(
            topic,
            type_name,
            qos,
            lambda: inner.subscribe(topic, type_name, qos, on_message),
            self._remove,
        )
        self._add(subscription)
        return subscription

    def advertise(self, topic: str, type_name: str, qos: Qos) -> Publisher:
        """Send a topic while active; see :meth:`rosplc.ros.backend.Backend.advertise`."""
        inner = self._inner
        if topic in self._always:
            return inner.advertise(topic, type_name, qos)
        publisher = GatedPublisher(
            topic, type_name, qos, lambda: inner.advertise(topic, type_name, qos), self._remove
        )
        self._add(publisher)
        return publisher

    def _add(self, endpoint: GatedSubscription | GatedPublisher) -> None:
        self.check(endpoint.type_name)
        with self._lock:
            if self.active:
                endpoint.open()
            self._endpoints.append(endpoint)

    def _remove(self, endpoint: object) -> None:
        with self._lock:
            self._endpoints = [one for one in self._endpoints if one is not endpoint]

    def activate(self) -> None:
        """Open all endpoints, or none.

        Raises:
            RosplcError: As the backend's ``subscribe`` and ``advertise``.
        """
        with self._lock:
            try:
                for endpoint in self._endpoints:
                    endpoint.open()
            except BaseException:
                self.deactivate()
                raise
            self.active = True

    def deactivate(self) -> None:
        """Close all endpoints; after the return no callback runs."""
        with self._lock:
            self.active = False
            for endpoint in self._endpoints:
                endpoint.shut()

    def status(self) -> tuple[EndpointStatus, ...]:
        """Return the state of all endpoints."""
        with self._lock:
            endpoints = list(self._endpoints)
        return tuple(endpoint.status() for endpoint in endpoints)

    @property
    def ended(self) -> str:
        """Why the node has left the graph for good; empty if it has not."""
        return ended_for_good(self._inner)

    def graph(self) -> GraphInfo:
        """Return what is seen of the other nodes."""
        return self._inner.graph()

    def close(self) -> None:
        """Close all endpoints and the backend; harmless twice."""
        self.deactivate()
        self._inner.close()
