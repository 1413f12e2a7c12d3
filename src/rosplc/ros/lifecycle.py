"""A backend whose endpoints exist only while it is active: the ROS side of a lifecycle node.

An inactive managed node neither receives nor sends. Requested endpoints are remembered, opened by
:meth:`LifecycleBackend.activate` and closed by :meth:`LifecycleBackend.deactivate`. At each activation, the
last messages of a latched topic are received again, as by any late subscriber, and are sent again. Open
service calls end when the node becomes inactive; no call is executed while it is inactive.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Collection
from contextlib import suppress
from dataclasses import replace
from functools import partial
from typing import Any

from rosplc.errors import BackendError, RosplcError
from rosplc.reasons import Reason
from rosplc.ros import backend
from rosplc.ros._base import Opener
from rosplc.ros.backend import Backend, EndpointStatus, GraphInfo, OnReply, Qos, Reply

_INACTIVE = "the node is not active"
_SUMMED = ("messages", "dropped", "rejected", "failed")


def _while_open(name: str) -> Any:
    """Return a server method that returns False while the node is inactive."""

    def method(endpoint: LifecycleEndpoint, *arguments: Any) -> bool:
        inner = endpoint._inner
        return inner is not None and bool(getattr(inner, name)(*arguments))

    return method


class LifecycleEndpoint:
    """A topic or service that is open while the backend is active; ``before`` shows the direction.

    If ``latched``, its last message is sent again at each activation.
    """

    def __init__(
        self,
        before: EndpointStatus,
        qos: Qos,
        make: Callable[[], Any],
        on_close: Callable[[Any], None],
        latched: bool,
    ) -> None:
        self.topic, self.type_name, self.qos = before.topic, before.type_name, qos
        self._before, self._make, self._on_close = before, make, on_close
        self._inner: Any = None
        self._closed = False
        self._latched, self._lock = latched, threading.RLock()
        self._last: tuple[bytes, int | None] | None = None
        self._repeated: bytes | None = None  # at activation; a sender that was refused before tries it again

    @property
    def matched(self) -> int:
        """Number of peers of the open endpoint."""
        inner = self._inner
        return 0 if inner is None else int(inner.matched)

    def open(self) -> None:
        """Open the endpoint; raises as the backend does."""
        if self._inner is None:
            inner = self._make()
            self.topic = inner.topic
            with self._lock:
                with suppress(RosplcError):  # a message that is not accepted prevents no activation
                    if self._last is not None and inner.write(*self._last):
                        self._repeated = self._last[0]
                self._inner = inner

    def shut(self) -> None:
        """Close the endpoint and keep its counts."""
        inner, self._inner = self._inner, None
        if inner is not None:
            inner.close()
            self._before = self._sum(inner.status())

    def _sum(self, now: EndpointStatus) -> EndpointStatus:
        counts = {name: getattr(self._before, name) + getattr(now, name) for name in _SUMMED}
        return replace(now, last_ns=now.last_ns or self._before.last_ns, **counts)

    def status(self) -> EndpointStatus:
        """Return the current state, with the total counts of all activations."""
        if (inner := self._inner) is not None:
            return self._sum(inner.status())
        code, reason = ("ROS009", "closed") if self._closed else ("", _INACTIVE)
        return replace(self._before, topic=self.topic, matched=0, code=code, reason=reason)

    def write(self, payload: bytes, stamp_ns: int | None = None) -> bool:
        """Send a message; raises ROS009 while the backend is inactive, and as the backend's publisher."""
        if not self._latched:
            return self._write(payload, stamp_ns)
        with self._lock:  # what is sent again comes before anything newer
            repeated, self._repeated = self._repeated, None
            if payload is repeated:
                return True
            self._last = payload, stamp_ns
            return self._write(payload, stamp_ns)

    def _write(self, payload: bytes, stamp_ns: int | None) -> bool:
        if (inner := self._inner) is None:
            raise BackendError("ROS009", "closed" if self._closed else _INACTIVE, where=self.topic)
        return bool(inner.write(payload, stamp_ns))

    @property
    def remembers(self) -> bool:
        """As the backend's server; True while inactive, as it is not known yet: answers to callers wait."""
        inner = self._inner
        return inner is None or bool(getattr(inner, "remembers", False))

    @property
    def ready(self) -> bool:
        """As the backend's client; False while inactive."""
        return bool(getattr(self._inner, "ready", False))

    reply, refuse, present = map(_while_open, ("reply", "refuse", "present"))

    def call(self, payload: bytes, on_reply: OnReply) -> int:
        """Send a request; not executed while inactive."""
        if (inner := self._inner) is None:
            on_reply(Reply(None, "not executed", Reason.NO_SERVER, _INACTIVE))
            return 0
        return int(inner.call(payload, on_reply))

    def forget(self, number: int) -> None:
        """Stop waiting for a call."""
        if (inner := self._inner) is not None:
            inner.forget(number)

    def close(self) -> None:
        """Close the endpoint permanently; a second call does nothing."""
        if not self._closed:
            self._closed = True
            self.shut()
            self._on_close(self)


class LifecycleBackend(Opener):
    """A backend that is connected while it is active; see :class:`rosplc.ros.backend.Backend`.

    Args:
        check: Called with the type name when an endpoint is requested, to refuse immediately what
            could not be opened later.
        always: Topics that are connected in every state.
        latched: Topics whose last message is sent again at each activation.
    """

    _kinds = ("subscribe", "advertise", "serve", "client")

    def __init__(
        self,
        inner: Backend,
        check: Callable[[str], None] = lambda _: None,
        always: Collection[str] = ("/clock", "/diagnostics", "/rosout"),
        latched: Collection[str] = (),
    ) -> None:
        self.name, self.capabilities, self.node = inner.name, inner.capabilities, inner.node
        self.active = False  # whether endpoints are open; they are not at first
        self.check = check
        self._inner, self._always, self._latched = inner, frozenset(always), frozenset(latched)
        self._lock = threading.RLock()
        self._endpoints: list[LifecycleEndpoint] = []

    def _open(self, kind: Any, topic: str, type_name: str, qos: Qos, *receiver: Any) -> Any:
        make = partial(getattr(self._inner, kind), topic, type_name, qos, *receiver)
        if topic in self._always:
            return make()
        self.check(type_name)
        before = EndpointStatus(topic, type_name, "in" if receiver else "out")
        latched = not receiver and topic in self._latched
        endpoint = LifecycleEndpoint(before, qos, make, self._remove, latched)
        with self._lock:
            if self.active:
                endpoint.open()
            self._endpoints.append(endpoint)
        return endpoint

    def _remove(self, endpoint: LifecycleEndpoint) -> None:
        with self._lock:
            self._endpoints = [one for one in self._endpoints if one is not endpoint]

    def activate(self) -> None:
        """Open all endpoints or none. Raises as the backend's ``subscribe`` and ``advertise``."""
        with self._lock:
            try:
                for endpoint in self._endpoints:
                    endpoint.open()
            except BaseException:
                self.deactivate()
                raise
            self.active = True

    def deactivate(self) -> None:
        """Close all endpoints; after this returns, no callback runs."""
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
        """Why the node has left the graph permanently; empty if it has not."""
        return backend.ended_for_good(self._inner)

    def graph(self) -> GraphInfo:
        """Return the graph of the other nodes."""
        return self._inner.graph()

    def close(self) -> None:
        """Close all endpoints and the backend; a second call does nothing."""
        self.deactivate()
        self._inner.close()
