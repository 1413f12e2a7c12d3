"""The rclpy backend: raw subscriptions and serialized publishing on a node of rclpy."""

from __future__ import annotations

import logging
from collections.abc import Callable, Mapping
from functools import partial
from typing import Any, Literal

from rclpy.callback_groups import MutuallyExclusiveCallbackGroup
from rclpy.exceptions import InvalidHandle
from rclpy.subscription import Subscription as NativeSubscription

from rosplc.clock import SYSTEM, Clock
from rosplc.errors import BackendError, RosplcError
from rosplc.ros._base import BaseNode, Context, Opener, check_ros, domain_number, graph_info, listed
from rosplc.ros.backend import EndpointInfo, GraphInfo, OnMessage, Qos, TypeSource
from rosplc.ros.names import join, validate_namespace, validate_node_name
from rosplc.ros.rclpy.endpoint import RclpyPublisher, RclpySubscription, create
from rosplc.ros.rclpy.messages import MessageClasses
from rosplc.ros.rclpy.parameters import show
from rosplc.ros.rclpy.peers import Peer, explain, profile, read_peers
from rosplc.ros.rclpy.spin import OwnNode, guard_takes, read_options

__all__ = ["RclpyBackend", "from_node", "open_backend"]

_logger = logging.getLogger("rosplc.ros.rclpy")

_SETTLE_NS = 1_000_000_000  # matching may take a moment; nothing is called a mismatch before
_GIVES_STAMPS = hasattr(NativeSubscription, "CallbackType")  # since ROS 2 Iron

RclpyEndpoint = RclpySubscription | RclpyPublisher


class RclpyBackend(BaseNode):
    """One node of rclpy; see :class:`rosplc.ros.backend.Backend`.

    Made by :func:`open_backend`, with a node and a thread of its own, or by :func:`from_node`, on a
    node that the caller spins.

    Attributes:
        name: ``rclpy``.
        capabilities: ``topics``.
        domain: The ROS domain.
        node: The node's full name.
    """

    name = "rclpy"
    capabilities = frozenset({"topics"})

    logger = _logger

    def __init__(self, node: Any, store: TypeSource, remap: Mapping[str, str], clock: Clock = SYSTEM) -> None:
        super().__init__(Context(store, node.get_name(), node.get_namespace(), remap=remap, clock=clock))
        self._node = node
        self._own: OwnNode | None = None
        self._classes = MessageClasses(store)
        self.domain: int = node.context.get_domain_id()
        # All callbacks in one group: one at a time, whatever executor spins the node.
        self._group = MutuallyExclusiveCallbackGroup()
        self._lost = False
        self._endpoints: list[RclpyEndpoint] = []
        self._short: dict[RclpyEndpoint, int] = {}
        self._guarded: Any = None  # the executor whose takes are

    # -- endpoints

    def check(self, type_name: str) -> None:
        """Find out whether a type can be carried, without opening anything.

        Raises:
            RosplcError: TYP001, ROS011 or ROS012.
        """
        _ = self._classes[self._store[type_name].name]

    def subscribe(self, topic: str, type_name: str, qos: Qos, on_message: OnMessage) -> RclpySubscription:
        """Receive a topic; see :meth:`rosplc.ros.backend.Backend.subscribe`."""
        full, name = self._resolve(topic, type_name)
        kind, native = self._classes[name], profile(qos)
        subscription = RclpySubscription(
            on_message, self._fitting, full, name, qos, self._forget, self._clock, native, self._diagnose
        )
        callback = subscription.receive if _GIVES_STAMPS else subscription.receive_plain
        make = partial(
            self._node.create_subscription, kind, full, callback, native, callback_group=self._group, raw=True
        )
        self._open(subscription, make)
        return subscription

    def advertise(self, topic: str, type_name: str, qos: Qos) -> RclpyPublisher:
        """Send a topic; see :meth:`rosplc.ros.backend.Backend.advertise`."""
        full, name = self._resolve(topic, type_name)
        kind, native = self._classes[name], profile(qos)
        publisher = RclpyPublisher(full, name, qos, self._forget, self._clock, native, self._diagnose)
        make = partial(self._node.create_publisher, kind, full, native, callback_group=self._group)
        self._open(publisher, make)
        return publisher

    def _open(self, endpoint: RclpyEndpoint, make: Callable[..., Any]) -> None:
        with self._lock:
            self._usable()
            try:
                if (executor := self._node.executor) is not None and executor is not self._guarded:
                    self._guarded = executor
                    guard_takes(executor, self._refuse)
                endpoint.entity = create(make, endpoint, self._look)
                endpoint.topic = endpoint.entity.topic_name  # after the node's own remapping rules
            except RosplcError:
                raise
            except Exception as error:
                raise refusal(f"cannot open {endpoint.topic} as {endpoint.type_name}", error) from error
            self._endpoints.append(endpoint)

    def _refuse(self, entity: object, error: Exception) -> None:
        for endpoint in tuple(self._endpoints):
            if endpoint.entity is entity and isinstance(endpoint, RclpySubscription):
                endpoint.refuse(error)
                return
        _logger.warning("a message could not be taken: %s", error)

    def _forget(self, endpoint: RclpyEndpoint) -> None:
        with self._lock:
            if endpoint in self._endpoints:
                self._endpoints.remove(endpoint)
            self._short.pop(endpoint, None)
        node, entity = self._node, endpoint.entity
        destroy = node.destroy_subscription if endpoint.direction == "in" else node.destroy_publisher
        # On the executor's thread, which would else meet a half-destroyed entity in its wait set.
        try:
            node.executor.create_task(partial(_destroy, destroy, entity))
        except Exception:  # nobody spins the node (any more)
            _destroy(destroy, entity)

    # -- what is wrong

    def _peers(self, topic: str, direction: Literal["in", "out"]) -> tuple[Peer, ...]:
        """Return the endpoints of one direction on a topic, our own node's too, as in ROS."""
        node = self._node
        ask = (
            node.get_publishers_info_by_topic if direction == "out" else node.get_subscriptions_info_by_topic
        )
        try:
            return read_peers(ask(topic), topic, direction)
        except (InvalidHandle, RuntimeError):  # the node is being destroyed
            return ()

    def _judge(self, endpoint: RclpyEndpoint) -> tuple[tuple[Peer, ...], list[tuple[str, str]]]:
        peers = self._peers(endpoint.topic, "out" if endpoint.direction == "in" else "in")
        ours = self._store.type_hash(endpoint.type_name)
        judged = (explain(peer, endpoint.type_name, ours, endpoint.profile) for peer in peers)
        return peers, sorted(filter(None, judged))

    def _fitting(self, subscription: RclpySubscription) -> int:
        peers, problems = self._judge(subscription)
        return len(peers) - len(problems)

    def _diagnose(self, endpoint: RclpyEndpoint) -> tuple[str, str]:
        if self._lost:
            return "ROS009", "the ROS context was shut down"
        peers, problems = self._judge(endpoint)
        if problems:
            return problems[0][0], listed(words for _, words in problems)
        if not peers:
            verb = "publishes" if endpoint.direction == "in" else "subscribes to"
            return "", f"no node {verb} {endpoint.topic}"
        return self._unexplained(endpoint, peers, len(peers) - endpoint.matched)

    def _unexplained(self, endpoint: RclpyEndpoint, peers: tuple[Peer, ...], short: int) -> tuple[str, str]:
        """Judge by count: rclpy does not tell which peers are matched."""
        if short <= 0:
            with self._lock:
                self._short.pop(endpoint, None)
            return "", ""
        now = self._clock.monotonic_ns()
        with self._lock:
            since = self._short.setdefault(endpoint, now)
        if now - since < _SETTLE_NS:
            return "", f"{listed(map(str, peers))}, not matched yet"
        why = "with another definition, or kept out by access rules"
        if short == len(peers):
            return "ROS003", listed(f"{peer} {why}" for peer in peers)
        return "ROS003", f"{short} of {len(peers)} peers {why}: {listed(map(str, peers))}"

    def _look(self, endpoint: RclpyEndpoint) -> None:
        """Say once in the log what the middleware's event is about; on the executor's thread."""
        if endpoint.closed or endpoint.entity is None:
            return
        code, reason = self._diagnose(endpoint)
        with self._lock:
            if not code or not self._logged.first((endpoint.topic, reason)):
                return
        _logger.warning("%s [%s]", reason, code)

    # -- looking at it

    def _endpoints_now(self) -> list[RclpyEndpoint]:
        return list(self._endpoints)

    def graph(self) -> GraphInfo:
        """Return what is seen of the other nodes."""
        if self._closed or self._lost:
            return GraphInfo()
        try:
            names = self._node.get_node_names_and_namespaces()
            found = [
                peer
                for topic, _ in self._node.get_topic_names_and_types()
                for direction in ("in", "out")
                for peer in self._peers(topic, direction)
                if peer.node != self.node
            ]
        except RuntimeError as error:  # InvalidHandle too: closed at this moment
            _logger.debug("the graph could not be read: %s", error)
            return GraphInfo()
        return graph_info(
            {join(namespace, name) for name, namespace in names} - {self.node},
            (EndpointInfo(p.topic, p.type_name, p.direction, p.node, p.qos, p.type_hash) for p in found),
        )

    def lose(self) -> None:
        """Note that the context is gone."""
        self._lost = True

    def adopt(self, own: OwnNode) -> None:
        """Take over the node's thread, to end it in :meth:`close`."""
        self._own = own

    def close(self) -> None:
        """Leave the graph; a node that was given stays. See :meth:`rosplc.ros.backend.Backend.close`."""
        with self._lock:
            own, self._own = self._own, None
            self._closed = True
            endpoints = list(self._endpoints)
        for endpoint in endpoints:
            endpoint.close()
        if own is not None:
            own.close()


def _destroy(destroy: Callable[[Any], bool], entity: Any) -> None:
    try:
        destroy(entity)
    except Exception:  # gone already, with its node
        _logger.debug("destroying an entity failed", exc_info=True)


def refusal(what: str, error: Exception) -> BackendError:
    """Return ROS002 for whatever rclpy raised."""
    return BackendError("ROS002", f"{what}: {str(error).strip() or type(error).__name__}")


def from_node(node: Any, store: TypeSource, *, remap: Mapping[str, str] | None = None) -> RclpyBackend:
    """Carry topics on a node that the caller owns and spins, such as a lifecycle node.

    Args:
        node: An ``rclpy.node.Node``; :meth:`RclpyBackend.close` leaves it alone.
        store: Where message types come from.
        remap: Topic → topic, besides the node's own rules.

    Raises:
        BackendError: ROS001 if the types are ROS 1's.
    """
    return RclpyBackend(node, store, remap or {})


def _open(context: Context) -> RclpyBackend:
    check_ros("rclpy", context.store)
    chosen = read_options(context.options)
    name, namespace = validate_node_name(context.node_name), validate_namespace(context.namespace)
    number = domain_number(context.domain, context.environment)
    try:
        own = OwnNode(name, namespace, number, chosen.ros_args)
    except Exception as error:
        raise refusal(f"cannot join the graph as {join(namespace, name)}", error) from error
    backend = RclpyBackend(own.node, context.store, context.remap, context.clock)
    backend.adopt(own)
    try:
        show(own.node, chosen.parameters)
    except BaseException:
        own.leave()
        raise
    own.start(backend.lose)
    return backend


open_backend = Opener(_open)
"""Connect to a ROS 2 graph with a context, a node and a thread of its own.

Arguments and errors are those of :func:`rosplc.ros.open_backend`. ``environment`` serves for
``ROS_DOMAIN_ID`` alone: everything else (RMW_IMPLEMENTATION, ROS_SECURITY_*, discovery) the
middleware reads from the process. ``options`` are described in :class:`rosplc.ros.rclpy.spin.Options`.
"""
