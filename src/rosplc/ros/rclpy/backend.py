"""The rclpy backend: raw subscriptions and serialized publishing on a node of rclpy."""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from functools import partial
from typing import Any, Literal

from rclpy.callback_groups import MutuallyExclusiveCallbackGroup
from rclpy.context import Context as RclContext
from rclpy.exceptions import InvalidHandle
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.node import Node

from rosplc.clock import SYSTEM, Clock
from rosplc.errors import BackendError, RosplcError
from rosplc.model import TypeStore
from rosplc.ros import _base
from rosplc.ros._base import BaseNode, Context, Problem
from rosplc.ros.backend import EndpointInfo, GraphInfo, Qos
from rosplc.ros.names import join, validate_namespace, validate_node_name
from rosplc.ros.rclpy import endpoint as ends
from rosplc.ros.rclpy.waiting import Waiting


def read_options(options: Mapping[str, object]) -> tuple[list[str], bool]:
    """Return the ROS arguments for the node, and whether it has rclpy's parameter services.

    The arguments are as after ``--ros-args`` on a command line: ``["-r", "cmd_vel:=base/cmd_vel",
    "--enclave", "/cell1"]``. Raises BackendError ROS013 if a key is unknown or has a value of the wrong type.
    """
    for key in options:
        if key not in ("ros_args", "parameter_services"):
            what = f"unknown key {key!r} in ros.rclpy; use ros_args or parameter_services"
            raise BackendError("ROS013", what)
    arguments = options.get("ros_args", ())
    if not isinstance(arguments, list | tuple) or not all(isinstance(one, str) for one in arguments):
        raise BackendError("ROS013", f"ros.rclpy.ros_args is {arguments!r}; it must be a list of strings")
    return [one for one in arguments if one != "--ros-args"], bool(options.get("parameter_services", True))


_logger = logging.getLogger("rosplc.ros.rclpy")


def guard_takes(executor: Any, refused: Callable[[Any, Exception], None]) -> None:
    """Prevent a message that cannot be taken from stopping all deliveries."""
    # An empty serialized message makes the middleware's take raise (rmw_cyclonedds). rclpy's executors then
    # never release the entity and its callback group, which is that of all our endpoints.
    known = getattr(executor._take_subscription, "refused", None)
    if known is not None:
        known.append(refused)
        return
    all_refused = [refused]
    for what in ("subscription", "service", "client"):
        take = getattr(executor, f"_take_{what}")
        # Humble's executor takes a response apart without a look.
        nothing = (None, None) if what == "client" and hasattr(executor, "_execute_client") else None
        setattr(executor, f"_take_{what}", _guarded(take, nothing, all_refused))


def _guarded(take: Callable[[Any], Any], nothing: Any, refused: list[Any]) -> Callable[[Any], Any]:
    def guarded(entity: Any) -> Any:
        try:
            return take(entity)
        except Exception as error:
            for each in refused:
                each(entity, error)
            return nothing

    guarded.refused = refused  # type: ignore[attr-defined]
    return guarded


class OwnNode:
    """A node with its own thread, which serves it until :meth:`close`; raises what rclpy raises.

    rclpy's process-wide state is not touched: its default context and signal handlers belong to the program
    that the bridge may be part of.
    """

    def __init__(
        self,
        name: str,
        namespace: str,
        domain: int | None,
        ros_args: Sequence[str],
        clock: Clock,
        parameter_services: bool,
    ) -> None:
        self.context = RclContext()
        self._clock = clock
        # Never None: rclpy would take the whole program's arguments. Without a domain it is ROS_DOMAIN_ID's.
        self.context.init(args=["--ros-args", *ros_args] if ros_args else [], domain_id=domain)
        try:
            self.node: Any = Node(
                name, context=self.context, namespace=namespace, start_parameter_services=parameter_services
            )
            self._executor = SingleThreadedExecutor(context=self.context)
            self._executor.add_node(self.node)
            self._waiting = Waiting(self._executor, self.node)
        except BaseException:
            self.context.try_shutdown()
            raise
        self._stopping = False
        self._thread = threading.Thread(target=self._run, name=f"rosplc-rclpy-{name}", daemon=True)

    def start(self, on_lost: Callable[[], None]) -> None:
        """Start to serve; ``on_lost`` is called if other code shuts the context down."""
        self._on_lost = on_lost
        self._thread.start()

    def close(self) -> None:
        """Stop serving and leave the graph; waits for this, unless called from a callback."""
        self._stopping = True
        with suppress(Exception):  # the executor is gone already, if the context was shut down
            self._executor.create_task(_nothing)  # what waits returns after it
        if threading.current_thread() is not self._thread:
            self._thread.join()

    def _run(self) -> None:
        try:
            while not self._stopping and self._spin():
                pass
        finally:
            self.leave()

    def _spin(self) -> bool:
        try:
            self._waiting.spin_once()
        except InvalidHandle:  # an entity was destroyed while the executor looked at it
            _logger.debug("the executor found a destroyed entity", exc_info=True)
        except ExternalShutdownException:
            pass
        except Exception:  # a defect; but the other topics have to go on
            _logger.exception("an error occurred while spinning node %s", self.node.get_name())
            self._clock.sleep(100_000_000)
        if self.context.ok() or self._stopping:
            return True
        _logger.error("the ROS context was shut down by other code; this node no longer carries messages")
        self._on_lost()
        return False

    def leave(self) -> None:
        """Release all resources; the thread's last task."""
        executor = self._executor
        for step in (
            self._waiting.release,
            self.node.destroy_node,
            executor.shutdown,
            self.context.try_shutdown,
        ):
            try:
                step()
            except Exception:  # the rest must still be given back
                _logger.debug("cannot leave the graph: %s failed", step, exc_info=True)


def _nothing() -> None:
    """Wake the executor."""


_LOOK_NS = 250_000_000

RclpyEndpoint = ends.RclpySubscription | ends.RclpyPublisher | ends.RclpyServer | ends.RclpyClient


class RclpyBackend(BaseNode):
    """One node of rclpy, with a thread (:func:`open_backend`) or spun by the caller (:func:`from_node`)."""

    name = "rclpy"
    _kinds = (ends.RclpySubscription, ends.RclpyPublisher, ends.RclpyServer, ends.RclpyClient)
    logger = logging.getLogger("rosplc.ros.rclpy")

    def __init__(
        self,
        node: Any,
        store: TypeStore,
        remap: Mapping[str, str],
        clock: Clock = SYSTEM,
        own: OwnNode | None = None,
    ) -> None:
        super().__init__(Context(store, node.get_name(), node.get_namespace(), remap=remap, clock=clock))
        self._node = node
        self._own = own  # its thread ends in :meth:`close`
        self._classes = ends.MessageClasses(store)
        self.domain: int = node.context.get_domain_id()
        # All callbacks in one group: one at a time, whatever executor spins the node.
        self._group = MutuallyExclusiveCallbackGroup()
        self._lost = False
        self._ending = threading.Event()
        self._watch: threading.Thread | None = None  # looks whether the servers of open calls have gone
        self._guarded: Any = None  # the executor whose takes are

    # -- endpoints

    def check(self, type_name: str) -> None:
        """Refuse a type that cannot be carried (TYP001, ROS011 or ROS012) without opening anything."""
        _ = self._classes[type_name if _base.is_service(type_name) else self._store[type_name].name]

    def _open(self, kind: Any, topic: str, type_name: str, qos: Qos, *receiver: Any) -> Any:
        full, name = self._resolve(topic, type_name)
        native_type = self._classes[name]
        type_hash = self._store.type_hash(f"{name}_Request" if kind.serves else name)
        endpoint: RclpyEndpoint = kind(*receiver, self, full, name, qos, type_hash)
        settings = ends.profile(_base.queue_of(qos) if kind.serves else qos)
        create = getattr(self._node, f"create_{endpoint.native}")
        others = {"qos_profile": settings, "callback_group": self._group, **endpoint.details()}
        make = partial(create, native_type, full, **others)
        with self._lock:
            self._usable()
            try:
                if (executor := self._node.executor) is not None and executor is not self._guarded:
                    self._guarded = executor
                    guard_takes(executor, self._refuse)
                if isinstance(endpoint, ends.RclpyServer | ends.RclpyClient):
                    native_topic = self._node.resolve_service_name(full)
                    endpoint.entity = make()
                    endpoint.attach(endpoint.entity)
                else:
                    endpoint.entity = ends.create(make, endpoint, self._look)
                    native_topic = endpoint.entity.topic_name
                endpoint.topic = native_topic  # after the node's own remapping rules
            except RosplcError:
                raise
            except Exception as error:
                raise refusal(f"cannot open {full} as {name}", error) from error
            self._endpoints.append(endpoint)
            if kind is ends.RclpyClient and self._watch is None:
                self._watch = threading.Thread(
                    target=self._look_after_calls, name="rosplc-calls-rclpy", daemon=True
                )
                self._watch.start()
        return endpoint

    def _look_after_calls(self) -> None:
        while not self._ending.is_set():
            self.clock.wait(self._ending, _LOOK_NS)
            for endpoint in self.endpoints():
                if isinstance(endpoint, ends.RclpyClient):
                    endpoint.look()

    def _refuse(self, entity: object, error: Exception) -> None:
        for endpoint in self.endpoints():
            if endpoint.entity is entity:
                endpoint.reject(error)
                return
        self.logger.warning("cannot take a message: %s", error)

    def forget(self, endpoint: RclpyEndpoint) -> None:
        """Note that an endpoint is being closed."""
        super().forget(endpoint)
        self._since.pop(endpoint, None)
        node, entity = self._node, endpoint.entity
        destroy = partial(self._destroy, getattr(node, f"destroy_{endpoint.native}"))
        # On the executor's thread, which would else meet a half-destroyed entity in its wait set.
        try:
            node.executor.create_task(partial(destroy, entity))
        except Exception:  # no executor spins the node (any more)
            destroy(entity)

    def _destroy(self, destroy: Callable[[Any], bool], entity: Any) -> None:
        try:
            destroy(entity)
        except Exception:  # gone already, with its node
            self.logger.debug("destroying an entity failed", exc_info=True)

    # -- what is wrong

    def _ends(self, topic: str, direction: Literal["in", "out"], no_mangle: bool = False) -> list[Any]:
        """Return the endpoints of one direction on a topic, including our own node's, as in ROS."""
        node = self._node
        ask = (
            node.get_publishers_info_by_topic if direction == "out" else node.get_subscriptions_info_by_topic
        )
        try:
            return list(ask(topic, no_mangle))
        except (InvalidHandle, RuntimeError):  # the node is being destroyed
            return []

    def _peers(
        self, name: str, direction: Literal["in", "out"], *, service: bool = False
    ) -> list[EndpointInfo]:
        """Return the endpoints of a topic, or of a service: readers (``in``) or writers of its requests."""
        found = self._users(name, direction) if service else self._ends(name, direction)
        return ends.read_peers(found, name, direction)

    def _users(self, service: str, direction: Literal["in", "out"]) -> list[Any]:
        return self._ends(f"rq{service}Request", direction, True)

    def servers(self, service: str) -> frozenset[bytes]:
        """Return the ids of a service's servers, as far as the middleware has topics for services."""
        return frozenset(bytes(info.endpoint_gid) for info in self._users(service, "in"))

    def fitting(self, endpoint: RclpyEndpoint) -> int:
        """Return the number of peers that match an endpoint."""
        peers, problems = self._compared(endpoint)
        return len(peers) - len(problems)

    def _compared(self, endpoint: RclpyEndpoint) -> tuple[list[EndpointInfo], list[Problem]]:
        theirs: Literal["in", "out"] = "out" if endpoint.direction == "in" else "in"
        peers = self._peers(endpoint.topic, theirs, service=endpoint.serves)
        return peers, [*filter(None, (_base.explain(peer, endpoint, _name(peer)) for peer in peers))]

    def _judge(self, endpoint: RclpyEndpoint) -> tuple[bool, list[Problem]]:
        if self._lost:
            return False, [("ROS009", "the ROS context was shut down")]
        peers, problems = self._compared(endpoint)
        if isinstance(endpoint, ends.RclpySubscription | ends.RclpyPublisher):
            return bool(peers), problems or self._unexplained(endpoint, peers)
        # Clients come and go: none is no doubt about a server.
        return isinstance(endpoint, ends.RclpyServer) or endpoint.ready, problems

    def _other_servers(self, endpoint: RclpyEndpoint) -> list[str]:
        found = self._peers(endpoint.topic, "in", service=True)
        servers = [_name(peer) or f"node {peer.node}" for peer in found]
        if endpoint.direction == "in" and f"node {self.node}" in servers:
            servers.remove(f"node {self.node}")
        return servers

    def _unexplained(self, endpoint: RclpyEndpoint, peers: list[EndpointInfo]) -> list[Problem]:
        """Diagnose by count: rclpy does not report which peers are matched."""
        short = len(peers) - endpoint.matched
        if short <= 0:
            self._since.pop(endpoint, None)
            return []
        found = [_base.describe(peer, _name(peer)) for peer in peers]
        if self._settling(endpoint):
            return [("", f"{_base.listed(found)}, not matched yet")]
        why = "another definition, or access rules prevent the connection"
        if short == len(peers):
            return [("ROS003", f"{each} with {why}") for each in found]
        return [("ROS003", f"{short} of {len(peers)} peers have {why}: {_base.listed(found)}")]

    def _look(self, endpoint: RclpyEndpoint) -> None:
        """Log the cause of a middleware event once; runs on the executor's thread."""
        if not endpoint.closed and endpoint.entity is not None:
            self._warn(endpoint)

    # -- looking at it

    def graph(self) -> GraphInfo:
        """Return the graph of the other nodes."""
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
            calls = [
                peer
                for topic, _ in self._node.get_topic_names_and_types(True)
                if topic.startswith("rq/") and topic.endswith("Request")
                for direction in ("in", "out")
                for peer in self._peers(topic[2:-7], direction, service=True)
                if peer.node != self.node
            ]
        except RuntimeError as error:  # InvalidHandle too: closed at this moment
            self.logger.debug("cannot read the graph: %s", error)
            return GraphInfo()
        nodes = {join(namespace, name) for name, namespace in names} - {self.node}
        return _base.graph_info(nodes, found, calls)

    def lose(self) -> None:
        """Note that the context was shut down."""
        self._lost = True

    def _stop(self) -> None:
        self._ending.set()
        if self._watch is not None and threading.current_thread() is not self._watch:
            self._watch.join()

    def _leave(self) -> None:
        """End our own node; a node passed by the caller stays."""
        if self._own is not None:
            self._own.close()


def _name(peer: EndpointInfo) -> str:
    return "" if peer.node else "a participant without a ROS node"


def refusal(what: str, error: Exception) -> BackendError:
    """Return ROS002 for an exception from rclpy."""
    return BackendError("ROS002", f"{what}: {str(error).strip() or type(error).__name__}")


def from_node(node: Any, store: TypeStore, *, remap: Mapping[str, str] | None = None) -> RclpyBackend:
    """Carry topics on a node that the caller owns, spins and closes, such as a lifecycle node.

    ``remap`` maps topics besides the node's own rules. Raises BackendError ROS001 if the types are ROS 1's.
    """
    return RclpyBackend(node, store, remap or {})


def _open(context: Context) -> RclpyBackend:
    _base.check_ros("rclpy", context.store)
    ros_args, services = read_options(context.options)
    name, namespace = validate_node_name(context.node_name), validate_namespace(context.namespace)
    number = _base.domain_number(context.domain, context.environment)
    try:
        own = OwnNode(name, namespace, number, ros_args, context.clock, services)
    except Exception as error:
        raise refusal(f"cannot join the graph as {join(namespace, name)}", error) from error
    backend = RclpyBackend(own.node, context.store, context.remap, context.clock, own)
    own.start(backend.lose)
    return backend


# Connect to a ROS 2 graph with a context, a node and a thread of its own.
#
# Arguments and errors are those of `rosplc.ros.open_backend`; `options` are described in `read_options`. Only
# `ROS_DOMAIN_ID` is read from `environment`; the middleware reads the rest from the process.
open_backend = _base.opener(_open)
