"""A ROS graph inside one process, for tests: the semantics of the other backends without a network.

Backends in one domain discover each other. As in DDS, the newest ``depth`` messages wait and
older ones are dropped; latched publishers serve late subscribers; different types and incompatible
settings prevent endpoints from matching, and the status shows this. Unlike DDS, only the header of a
payload is checked. A request is sent to every server, and the first response counts.
"""

from __future__ import annotations

import itertools
import logging
import struct
import threading
from collections import deque
from typing import Any

from rosplc.model import TypeStore
from rosplc.ros import _base
from rosplc.ros.backend import EndpointInfo, GraphInfo, Qos, Reply

_domains: dict[int, list[MemoryBackend]] = {}
_unnamed = itertools.count(1 << 20)  # domains that no configuration has
_graph = threading.RLock()  # guards _domains and every list of endpoints: one small graph, one lock


class _Endpoint(_base.BaseEndpoint):
    _put: Any  # of those that receive

    def __init__(self, *arguments: Any) -> None:
        super().__init__(*arguments)
        self._lock = _graph
        self.info = EndpointInfo(
            self.topic, self.type_name, self.direction, self._node.node, self.qos, self.type_hash
        )

    def _checked(self, payload: bytes) -> bytes:
        return bytes(payload) if self._node.plain else super()._checked(payload)

    def put(self, *message: Any) -> None:
        """Queue what is received: a message, a request, or the number and end of a call."""
        with _graph:
            self._put(*message)
        self._node.news.set()

    def others(self) -> list[Any]:
        """Return the endpoints that may match this one, including those on the same node, as in ROS."""
        return [
            endpoint
            for backend in _domains.get(self._node.domain, [])
            for endpoint in backend.endpoints()
            if endpoint.topic == self.topic
            and endpoint.serves == self.serves
            and endpoint.direction != self.direction
        ]

    def peers(self) -> list[Any]:
        """Return the endpoints that exchange messages with this one."""
        return [other for other in self.others() if _base.explain(other.info, self) is None]

    def _matched(self) -> int:
        with _graph:
            return len(self.peers())

    def close(self) -> None:
        """Leave the graph; a second call does nothing."""
        with _graph:
            super().close()


class MemorySubscription(_base.QueuedSubscription, _Endpoint):
    """A subscription; see :class:`rosplc.ros.backend.Subscription`."""


class MemoryPublisher(_base.BasePublisher, _Endpoint):
    """A publisher; see :class:`rosplc.ros.backend.Publisher`."""

    def __init__(self, *arguments: Any) -> None:
        super().__init__(*arguments)
        latched = self.qos.depth if self.qos.durability == "transient_local" else 0
        self.kept: deque[tuple[bytes, int]] = deque(maxlen=latched)

    def _emit(self, payload: bytes, stamp_ns: int) -> bool:
        self.kept.append((payload, stamp_ns))
        for peer in self.peers():
            peer.put(payload, stamp_ns)
        return True


class MemoryServer(_base.Queued, _base.KeepingServer, _Endpoint):
    """A service server; see :class:`rosplc.ros.backend.ServiceServer`."""

    _take = _base.KeepingServer._take

    def _waits(self, caller: bytes, origin: Any) -> bool:
        return not origin.closed

    def _answer(self, caller: bytes, origin: Any, payload: bytes) -> bool:
        origin.put(struct.unpack_from("<Q", caller, 8)[0], Reply(payload))
        return True

    def close(self) -> None:
        """Leave the graph; calls that no other server has received end."""
        clients = self.others()
        super().close()
        for client in clients:
            while client.deliver_next():  # what was answered before
                pass
            client.gone(self)


class MemoryClient(_base.Queued, _base.BaseClient, _Endpoint):
    """A service client; see :class:`rosplc.ros.backend.ServiceClient`."""

    _take = _base.BaseClient.end

    def _receivers(self) -> list[Any]:
        return self.peers()

    def _send(self, number: int, payload: bytes) -> None:
        caller = struct.pack("<QQ", id(self), number)
        with _graph:
            for server in self.calls.get(number, (None, ()))[1]:
                server.put(payload, caller, self._clock.time_ns(), self)


class MemoryBackend(_base.BaseNode):
    """One node of the graph in this process; see :class:`rosplc.ros.backend.Backend`."""

    name = "memory"
    _kinds = (MemorySubscription, MemoryPublisher, MemoryServer, MemoryClient)
    ros1 = None
    logger = logging.getLogger("rosplc.ros.memory")

    def __init__(self, context: _base.Context) -> None:
        super().__init__(context)
        self.domain = domain = _base.domain_number(context.domain, context.environment) or 0
        self.plain = context.store.distro == "noetic"  # ROS 1's bytes do not show whether they fit a type
        self.news = threading.Event()  # messages wait, or the node is being closed
        self._lock = _graph
        with _graph:
            _domains.setdefault(domain, []).append(self)
        self._start(self._run, f"rosplc-memory-{domain}")

    def _run(self) -> None:
        while not self._closed:
            self.news.wait()
            self.news.clear()
            for endpoint in self.endpoints():
                while isinstance(endpoint, _base.Queued) and endpoint.deliver_next():
                    pass

    def _open(self, kind: Any, topic: str, type_name: str, qos: Qos, *receiver: Any) -> Any:
        full, name = self._resolve(topic, type_name)
        endpoint = kind(*receiver, self, full, name, qos, self._hash(name))
        with _graph:
            self._endpoints.append(endpoint)
            if kind is MemorySubscription and qos.durability == "transient_local":
                for peer in endpoint.peers():
                    # No loss: a subscriber with a smaller queue asks for fewer old messages.
                    for message in list(peer.kept)[-qos.depth :]:
                        endpoint.put(*message)
        return endpoint

    def _judge(self, endpoint: _Endpoint) -> tuple[bool, list[_base.Problem | None]]:
        with _graph:
            others = endpoint.others()
            return bool(others), [_base.explain(other.info, endpoint) for other in others]

    def _other_servers(self, endpoint: _Endpoint) -> list[str]:
        with _graph:
            ends = [end for node in _domains.get(self.domain, []) for end in node.endpoints()]
        same = [end for end in ends if end.serves and end.topic == endpoint.topic and end is not endpoint]
        return [f"node {end.info.node}" for end in same if end.direction == "in"]

    def graph(self) -> GraphInfo:
        """Return the graph of the other nodes."""
        with _graph:
            others = [backend for backend in _domains.get(self.domain, []) if backend is not self]
            ends = [endpoint for backend in others for endpoint in backend.endpoints()]
        infos, calls = ([end.info for end in ends if end.serves is serves] for serves in (False, True))
        return _base.graph_info((backend.node for backend in others), infos, calls)

    def _stop(self) -> None:
        with _graph:
            _domains[self.domain].remove(self)
            if not _domains[self.domain]:
                del _domains[self.domain]
        self.news.set()

    def _leave(self) -> None:
        self._join()


# Connect to the graph of this process; arguments, without options, as `rosplc.ros.open_backend`.
open_backend = _base.opener(MemoryBackend)


def open_apart(store: TypeStore, *names: str) -> list[MemoryBackend]:
    """Connect nodes with these names to a separate graph."""
    domain = next(_unnamed)
    return [open_backend(store, name, domain=domain) for name in names]
