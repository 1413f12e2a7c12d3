"""The ROS 1 backend: one node with a master, any number of them in one process."""

from __future__ import annotations

import contextlib
import logging
import threading
from dataclasses import replace
from typing import Any

from rosplc.errors import BackendError
from rosplc.ros._base import BaseNode, Context, Opener, graph_info, listed
from rosplc.ros.backend import EndpointInfo, GraphInfo, OnMessage, Qos
from rosplc.ros.rospy.address import read_address
from rosplc.ros.rospy.handshake import ANY, ros2_name
from rosplc.ros.rospy.inbound import Incoming, RospySubscription
from rosplc.ros.rospy.keeper import Endpoint, Keeper, Key
from rosplc.ros.rospy.outbound import Outgoing, RospyPublisher
from rosplc.ros.rospy.slave import Servers

__all__ = ["RospyBackend", "open_backend"]

_logger = logging.getLogger("rosplc.ros.rospy")

_CONNECTING = 16  # connections that are being made at once
_SETTLE_NS = 5_000_000_000  # a subscriber that is not there by then cannot reach us


class RospyBackend(BaseNode):
    """One ROS 1 node; see :class:`rosplc.ros.backend.Backend`.

    Attributes:
        name: ``rospy``.
        capabilities: ``topics``.
        node: The node's full name.
        uri: The URI of its XML-RPC interface.
    """

    name = "rospy"
    capabilities = frozenset({"topics"})

    logger = _logger

    def __init__(self, context: Context) -> None:
        super().__init__(context, ros1=True)
        environment = context.environment
        self._turn = threading.RLock()
        self._connecting = threading.BoundedSemaphore(_CONNECTING)
        self._ended = ""
        self._endpoints: dict[Key, Endpoint] = {}
        self._handles: dict[int, RospySubscription | RospyPublisher] = {}
        self._missed: dict[tuple[str, str], int] = {}
        self._keeper: Keeper | None = None
        address = read_address(environment)
        try:
            self._servers = Servers(self.node, address, self)
        except OSError as error:
            raise BackendError(
                "ROS010", f"cannot listen at {address.bind or 'any address'}: {error}", where="ROS_IP"
            ) from error
        self.uri = self._servers.uri
        self._keeper = Keeper(self.node, address.master, self.uri, self._wanted, self._moved)

    # -- endpoints

    def subscribe(self, topic: str, type_name: str, qos: Qos, on_message: OnMessage) -> RospySubscription:
        """Receive a topic; see :meth:`rosplc.ros.backend.Backend.subscribe`.

        Raises:
            BackendError: ROS002 if this node receives the topic as another type already.
        """
        with self._lock:
            incoming: Incoming = self._endpoint("in", topic, type_name)
            subscription = RospySubscription(
                incoming, qos, on_message, self._diagnose, self._forget, self._clock
            )
            incoming.add(subscription)
            self._handles[id(subscription)] = subscription
        self._wake()
        return subscription

    def advertise(self, topic: str, type_name: str, qos: Qos) -> RospyPublisher:
        """Send a topic; raises as :meth:`subscribe` does."""
        with self._lock:
            outgoing: Outgoing = self._endpoint("out", topic, type_name)
            publisher = RospyPublisher(outgoing, qos, self._diagnose, self._forget, self._usable, self._clock)
            outgoing.add(publisher)
            self._handles[id(publisher)] = publisher
        self._wake()
        return publisher

    def _endpoint(self, direction: str, topic: str, type_name: str) -> Any:
        full, name = self._resolve(topic, type_name)
        known = self._endpoints.get((direction, full))
        if known is not None:
            if known.type_name != name:
                raise BackendError(
                    "ROS002",
                    f"{self.node} has {full} as {known.type_name} already; {name} is another type",
                    remedy="A node of ROS 1 has one type for each topic.",
                )
            return known
        identity = (self.node, full, name, self._store.md5(name), self._store.definition_text(name))
        made: Endpoint
        if direction == "in":
            made = Incoming(*identity, self._turn, self._connecting, self._wake, self._clock)
        else:
            made = Outgoing(*identity, self._wake)
        self._endpoints[direction, full] = made
        return made

    def _forget(self, handle: RospySubscription | RospyPublisher) -> None:
        if isinstance(handle, RospySubscription):
            endpoint: Endpoint = handle.incoming
            left = handle.incoming.remove(handle)  # waits for a callback that runs
        else:
            endpoint = handle.outgoing
            left = handle.outgoing.remove(handle)
        with self._lock:
            self._handles.pop(id(handle), None)
            key = (endpoint.direction, endpoint.topic)
            last = not left and self._endpoints.get(key) is endpoint
            if last and not (
                endpoint.subscriptions if isinstance(endpoint, Incoming) else endpoint.publishers
            ):
                del self._endpoints[key]
        if last:
            endpoint.close()
            self._wake()

    def _usable(self) -> None:
        super()._usable()
        if self._ended:
            raise BackendError("ROS015", self._ended)

    def _wake(self) -> None:
        if self._keeper is not None:
            self._keeper.wake()

    def _wanted(self) -> dict[Key, Endpoint]:
        with self._lock:
            return dict(self._endpoints)

    # -- what the node's servers ask

    def incoming(self) -> dict[str, Incoming]:
        """Return the topics that are received."""
        return {e.topic: e for e in self._wanted().values() if isinstance(e, Incoming)}

    def outgoing(self) -> dict[str, Outgoing]:
        """Return the topics that are sent."""
        return {e.topic: e for e in self._wanted().values() if isinstance(e, Outgoing)}

    def publishers_changed(self, topic: str, uris: tuple[str, ...]) -> None:
        """Take the master's word for who publishes a topic."""
        with self._lock:
            endpoint = self._endpoints.get(("in", topic))
        if isinstance(endpoint, Incoming):
            endpoint.publishers = uris
            endpoint.update()

    def told_to_leave(self, caller: str, why: str) -> None:
        """Leave, as ROS 1 asks of a node whose name another one has taken, and of one that is killed."""
        if "same name" in why:
            self._end(f"another node named {self.node} has joined, and ROS 1 keeps the newer one")
        else:
            self._end(
                f"{caller or 'somebody'} told node {self.node} to shut down ({why or 'no reason given'})"
            )

    def _moved(self, uri: str) -> None:
        self._end(f"the node at {uri} has taken the name {self.node}, and ROS 1 keeps the newer one")

    @property
    def ended(self) -> str:
        """Why the node was told to leave the graph; empty if it was not."""
        return self._ended

    def _end(self, why: str) -> None:
        if self._closed or self._ended:
            return
        self._ended = why
        _logger.error("%s; this one carries nothing any more [ROS015]", why)
        threading.Thread(target=self._leave, name="rosplc-leave", daemon=True).start()

    def _leave(self) -> None:
        """Disconnect, and keep the handles so that their status tells why."""
        if self._keeper is not None:
            # Withdrawing by URI: the master leaves the newer node of our name alone.
            self._keeper.close(withdraw=True)
        for endpoint in self._wanted().values():
            endpoint.close()
        self._servers.close()

    # -- what is wrong

    def _diagnose(self, endpoint: Endpoint) -> tuple[str, str]:
        keeper = self._keeper
        if self._ended:
            return "ROS015", self._ended
        if self._closed or keeper is None:
            return "", ""
        found = (
            self._strange_publishers(endpoint)
            if isinstance(endpoint, Incoming)
            else (self._strange_subscribers(endpoint, keeper))
        )
        if keeper.trouble:
            found.append(("ROS014", keeper.trouble))
        if found:
            code = max(code for code, _ in found)
            reason = listed(sorted(text for _, text in found))
            # ROS014 is said by the keeper, once for all topics.
            if code and code != "ROS014" and self._logged.first((endpoint.topic, reason)):
                _logger.warning("%s [%s]", reason, code)
            return code, reason
        if endpoint.matched():
            return "", ""
        verb = "publishes" if endpoint.direction == "in" else "subscribes to"
        return "", f"no node {verb} {endpoint.topic}"

    def _strange_publishers(self, incoming: Incoming) -> list[tuple[str, str]]:
        named = set(incoming.publishers)
        return [
            link.problem
            for link in incoming.links()
            if link.problem is not None and not link.connected and link.uri in named
        ]

    def _strange_subscribers(self, outgoing: Outgoing, keeper: Keeper) -> list[tuple[str, str]]:
        found = [wrong for _, wrong in list(outgoing.strangers.values())]
        named = keeper.state.subscribers.get(outgoing.topic, frozenset())
        absent = named - outgoing.subscribers() - set(outgoing.strangers)
        now = self._clock.monotonic_ns()
        for node in sorted(absent):
            since = self._missed.setdefault((outgoing.topic, node), now)
            text = f"node {node} subscribes to {outgoing.topic}, not connected yet"
            if now - since > _SETTLE_NS:
                text += f"; it may not be able to reach {self.uri}: set ROS_IP or ROS_HOSTNAME"
            found.append(("", text))
        # A copy, in one step: several threads may ask at once.
        for key in [k for k in tuple(self._missed) if k[0] == outgoing.topic and k[1] not in absent]:
            self._missed.pop(key, None)
        return found

    # -- looking at it

    def _endpoints_now(self) -> list[RospySubscription | RospyPublisher]:
        return list(self._handles.values())

    def graph(self) -> GraphInfo:
        """Return what the master said of the other nodes, a second ago at most.

        ROS 1 knows a topic's type and no quality of service: only who latches, once connected.
        """
        if self._keeper is None or self._closed:
            return GraphInfo()
        state = self._keeper.state
        latching = {
            (topic, link.node)
            for topic, incoming in self.incoming().items()
            for link in incoming.links()
            if link.latching
        }
        seen = []
        for direction, table in (("in", state.subscribers), ("out", state.publishers)):
            for topic, nodes in table.items():
                kind = ros2_name(state.types.get(topic, ANY))
                for node in nodes - {self.node}:
                    durable = direction == "out" and (topic, node) in latching
                    qos = Qos(durability="transient_local" if durable else "volatile", depth=1)
                    seen.append(EndpointInfo(topic, kind, "in" if direction == "in" else "out", node, qos))
        found = graph_info(state.nodes - {self.node}, seen)
        told = {topic: tuple(kind for kind in kinds if kind != ANY) for topic, kinds in found.topics.items()}
        return replace(found, topics=told)

    def close(self) -> None:
        """Leave the graph; see :meth:`rosplc.ros.backend.Backend.close`."""
        with self._lock:
            if self._closed:
                return
            self._closed = True
            handles, self._handles = list(self._handles.values()), {}
            endpoints, self._endpoints = list(self._endpoints.values()), {}
        keeper, self._keeper = self._keeper, None
        if keeper is not None:
            keeper.close(withdraw=True)
        for handle in handles:
            handle.close()
        ending = [ended for endpoint in endpoints for ended in endpoint.close()]
        self._servers.close()
        for one in ending:
            with contextlib.suppress(RuntimeError):
                one.join()


open_backend = Opener(RospyBackend)
"""Connect to a ROS 1 graph; arguments and errors as for :func:`rosplc.ros.open_backend`.

ROS 1 has no domains: ``ROS_MASTER_URI`` tells which graph it is. There are no options. The call
returns at once, with or without a master; the node registers as soon as there is one.
"""
