"""The ROS 1 backend: a node registered with a master; a process can have any number of nodes."""

from __future__ import annotations

import contextlib
import logging
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from typing import Any, Literal

from rosplc.errors import BackendError
from rosplc.ros._base import BaseNode, Context, Problem, graph_info, opener
from rosplc.ros.backend import EndpointInfo, GraphInfo, Qos
from rosplc.ros.parameters import Apply, Parameter
from rosplc.ros.rospy.handshake import ANY, Definition, ros2_name
from rosplc.ros.rospy.master import Master, RefusedError, SystemState, UnreachableError, read_address
from rosplc.ros.rospy.parameters import MasterParameters
from rosplc.ros.rospy.services import RospyClient, RospyServer
from rosplc.ros.rospy.slave import Servers
from rosplc.ros.rospy.topics import Connections, Incoming, Outgoing, RospyPublisher, RospySubscription

_logger = logging.getLogger("rosplc.ros.rospy")

_TICK_NS = 250_000_000
_PERIOD_NS = 1_000_000_000
_SHARE = 50  # the watch takes at most this part of the time, however large the graph

Key = tuple[str, str]  # Direction (`in` or `out`) and topic, or `serve` and service.
Registered = Incoming | Outgoing | RospyServer


class Registration:
    """A thread that keeps the registration of one node with the master up to date.

    rospy registers once. A restarted master has no registrations, and rospy nodes then reach only the nodes
    that they already know. Here, the master is queried every second, and missing registrations are repeated.
    """

    def __init__(self, node: Any, master: str) -> None:
        self.trouble = ""  # why the master cannot be reached, in words; empty if it can
        self.state = SystemState()  # what the master knew when it was last asked
        self._node, self._clock = node, node.clock
        self._master = Master(master, node.node, clock=node.clock)
        self._registered: dict[Key, Registered] = {}
        self._due_ns = 0
        self._wake = threading.Event()
        self._closing = False
        self._thread = threading.Thread(target=self._run, name="rosplc-master", daemon=True)

    def start(self) -> None:
        """Start, when the node can be reached."""
        self._thread.start()

    def wake(self) -> None:
        """Make the thread check the topics now."""
        self._wake.set()

    def close(self) -> None:
        """Stop, and unregister the node if the master answers."""
        self._closing = True
        self._wake.set()
        if threading.current_thread() is not self._thread:
            self._thread.join(5.0)
        if not self.trouble and not self._thread.is_alive():
            # By URI: the master leaves a newer node of our name alone.
            with contextlib.suppress(UnreachableError, RefusedError):
                for topic in self._registered.values():
                    topic.unregister(self._master)
        self._registered = {}
        self._master.close()

    def _run(self) -> None:
        while not self._closing:
            self._clock.wait(self._wake, _TICK_NS)
            self._wake.clear()
            if self._closing:
                return
            try:
                self._turn()
            except Exception:  # a defect; but the node has to stay registered
                _logger.exception("checking node %s failed", self._node.node)
                self._clock.sleep(500_000_000)

    def _turn(self) -> None:
        wanted: dict[Key, Registered] = self._node.topics()
        now = self._clock.monotonic_ns()
        if not self.trouble or now >= self._due_ns:
            try:
                if now >= self._due_ns:
                    self._watch(wanted)
                self._settle(wanted)
                if (parameters := self._node.parameters) is not None:
                    self._ask(("parameters of", self._node.node), parameters.look)
            except UnreachableError as error:
                self._lost(str(error))
        for one in (*wanted.values(), *self._node.clients()):
            if not isinstance(one, Outgoing):
                one.update()

    def _watch(self, wanted: dict[Key, Registered]) -> None:
        node, uri = self._node.node, self._master.uri
        start, busy = self._clock.monotonic_ns(), time.thread_time_ns()
        self._due_ns = start + _PERIOD_NS
        self.state = self._master.state(self.state)
        # A service has one server: one that another node has taken is left to it until it leaves.
        lacks = [
            key
            for key in self._registered
            if node not in (known := self._known(*key)) and not (key[0] == "serve" and known)
        ]
        if lacks and node in self.state.nodes:
            other = self._master.node_uri(node)
            if other and other != self._node.uri:
                self._node.moved(other)
                return
        for key in lacks:
            del self._registered[key]
        if self.trouble:
            _logger.info("the ROS master at %s answers; registering node %s", uri, node)
            self.trouble = ""
        elif lacks:
            what = f"the ROS master at {uri} lost {len(lacks)} topics or services of node {node}"
            _logger.warning("%s (it was restarted, or they were removed); registering them again", what)
        for key, topic in wanted.items():
            if isinstance(topic, Outgoing):
                named = self._known("in", topic.topic)
                for stranger, (since, _) in list(topic.strangers.items()):
                    # One that came after the master was asked is missing in the answer by right.
                    if stranger not in named and since < start:
                        topic.strangers.pop(stranger, None)
            elif isinstance(topic, Incoming) and len(self._known("out", key[1])) != len(topic.publishers):
                self._registered.pop(key, None)  # a notice was missed: registering again tells who there is
        self._due_ns = max(self._due_ns, start + _SHARE * (time.thread_time_ns() - busy))

    def _known(self, direction: str, topic: str) -> frozenset[str]:
        state = self.state
        tables = {"in": state.subscribers, "out": state.publishers, "serve": state.services}
        return tables[direction].get(topic, frozenset())

    def _settle(self, wanted: dict[Key, Registered]) -> None:
        for key in [key for key, topic in self._registered.items() if wanted.get(key) is not topic]:
            self._ask(key, self._registered[key].unregister)
            del self._registered[key]
        for key, topic in wanted.items():
            if key not in self._registered and not self._closing:
                self._ask(key, topic.register)
                self._registered[key] = topic

    def _ask(self, key: Key, method: Callable[[Master], object]) -> None:
        try:
            method(self._master)
        except RefusedError as error:
            _logger.warning("the ROS master refused %s: %s", key, error)

    def _lost(self, why: str) -> None:
        text = f"the ROS master at {self._master.uri} does not answer ({why})"
        if not self.trouble:
            _logger.warning("%s; node %s keeps trying", text, self._node.node)
        self.trouble = text
        self._due_ns = self._clock.monotonic_ns() + _PERIOD_NS


_CONNECTING = 16  # connections that are being made at once
_SETTLE_NS = 5_000_000_000  # a subscriber that has not connected by then cannot reach us


class RospyBackend(BaseNode):
    """One ROS 1 node; see :class:`rosplc.ros.backend.Backend`."""

    name = "rospy"
    _kinds = (RospySubscription, RospyPublisher, RospyServer, RospyClient)
    ros1 = True
    logger = logging.getLogger("rosplc.ros.rospy")

    def __init__(self, context: Context) -> None:
        super().__init__(context)
        self.turn = threading.RLock()  # held while messages are handed over; taken before the node's lock
        # bounds how many connections are being made at once
        self.connecting = threading.BoundedSemaphore(_CONNECTING)
        self.ended = ""  # why the node was told to leave the graph; empty if it was not
        self.parameters: MasterParameters | None = None  # what it has on the master's server
        self._topics: dict[Key, Any] = {}
        self._ending: list[Any] = []
        address = read_address(context.environment)
        self._registration = Registration(self, address.master)
        try:
            self._servers = Servers(address, self, self.clock)
        except OSError as error:
            what = f"cannot listen on {address.bind or 'any address'}: {error}"
            raise BackendError("ROS010", what, where="ROS_IP") from error
        self.inbound, self.outbound = Connections("rosplc-receive"), Connections("rosplc-send")
        self.uri = self._servers.uri  # the URI of its XML-RPC interface
        # where its services are called
        self.service_uri = f"rosrpc://{address.host}:{self._servers.data.port}"
        self.master_uri = address.master  # the master's URI
        self._registration.start()

    # -- endpoints

    def _open(self, kind: Any, topic: str, type_name: str, qos: Qos, *receiver: Any) -> Any:
        """Open an endpoint; ROS002 if this node uses the topic with another type or serves the service."""
        with self._lock:
            if kind.serves:
                endpoint = kind(*receiver, self, *self._resolve(topic, type_name), qos)
                key = ("serve", endpoint.topic)
                if kind is RospyServer and self._topics.setdefault(key, endpoint) is not endpoint:
                    what = f"{self.node} already serves {endpoint.topic}"
                    raise BackendError("ROS002", what, remedy="Use one server per service in ROS 1.")
            else:
                shared = self._shared(Incoming if kind is RospySubscription else Outgoing, topic, type_name)
                endpoint = kind(*receiver, shared, qos)
                shared.add(endpoint)
            self._endpoints.append(endpoint)
        self.wake()
        return endpoint

    def _shared(self, kind: Any, topic: str, type_name: str) -> Any:
        full, name = self._resolve(topic, type_name)
        known = self._topics.get((kind.direction, full))
        if known is None:
            definition = Definition(name, self._store.md5(name), self._store.definition_text(name))
            known = self._topics[kind.direction, full] = kind(self, full, definition)
        elif known.definition.type_name != name:
            what = f"{self.node} already uses {full} as {known.definition.type_name}, not {name}"
            raise BackendError("ROS002", what, remedy="Use one type per topic in a ROS 1 node.")
        return known

    def service_md5(self, type_name: str) -> str:
        """Return the MD5 sum of a service."""
        return self._store.service_md5(type_name)

    def forget(self, endpoint: Any) -> None:
        """Note that an endpoint is being closed."""
        if not isinstance(endpoint, RospySubscription | RospyPublisher):
            with self._lock:
                super().forget(endpoint)
                if isinstance(endpoint, RospyServer):
                    self._topics.pop(("serve", endpoint.topic), None)
            self.wake()
            return
        shared = endpoint.shared
        shared.remove(endpoint)  # waits for a callback that runs
        with self._lock:
            super().forget(endpoint)
            key = (shared.direction, shared.topic)
            last = not shared.handles and self._topics.get(key) is shared
            if last:
                del self._topics[key]
        if last:
            ending = shared.close()
            if self._closed:  # they are waited for in the end
                self._ending += ending
            self.wake()

    def usable(self) -> None:
        """Raise ROS009 after :meth:`close`, ROS015 if the node was asked to shut down."""
        super()._usable()
        if self.ended:
            raise BackendError("ROS015", self.ended)

    _usable = usable

    def wake(self) -> None:
        """Have the topics checked now: a connection, topic or handle was added or removed."""
        self._registration.wake()

    def topics(self) -> dict[Key, Any]:
        """Return the topics that should be registered."""
        with self._lock:
            return dict(self._topics)

    # -- what the node's servers and the master ask

    def having(self, direction: str) -> dict[str, Any]:
        """Return the topics that are received (``in``) or sent (``out``), or the services (``serve``)."""
        return {topic: one for (kind, topic), one in self.topics().items() if kind == direction}

    def clients(self) -> list[RospyClient]:
        """Return the services that are called."""
        return [one for one in self.endpoints() if isinstance(one, RospyClient)]

    def servers(self, service: str) -> frozenset[str]:
        """Return the nodes that serve a service, according to the master at most a second ago."""
        return self._registration.state.services.get(service, frozenset())

    def keep_parameters(
        self, declared: Sequence[Parameter], apply: Apply = lambda _values, done: done("")
    ) -> MasterParameters:
        """Keep parameters on the master's parameter server, as a ParameterServer does in ROS 2."""
        self.parameters = MasterParameters(self, declared, apply)
        self.wake()
        return self.parameters

    def publishers_changed(self, topic: str, uris: tuple[str, ...]) -> None:
        """Update the publishers of a topic as reported by the master."""
        if (incoming := self.having("in").get(topic)) is not None:
            incoming.publishers = uris
            incoming.update()

    def told_to_leave(self, caller: str, why: str) -> None:
        """Shut down, as ROS 1 requires of a node whose name another node has taken, or that is killed."""
        if "same name" in why:
            self._end(f"another node named {self.node} has started, and ROS 1 keeps the newer node")
        else:
            self._end(
                f"{caller or 'a node'} asked node {self.node} to shut down ({why or 'no reason given'})"
            )

    def moved(self, uri: str) -> None:
        """Shut down: another node has taken this node's name."""
        self._end(f"the node at {uri} has taken the name {self.node}, and ROS 1 keeps the newer node")

    def _end(self, why: str) -> None:
        if not self._closed and not self.ended:
            self.ended = why
            self.logger.error("%s; this node no longer carries messages [ROS015]", why)
            threading.Thread(target=self._disconnect, name="rosplc-leave", daemon=True).start()

    def _disconnect(self) -> None:
        """Disconnect, but keep the endpoints, so that their status shows the reason."""
        self._registration.close()
        for topic in self.topics().values():
            topic.disconnect() if isinstance(topic, RospyServer) else topic.close()
        self._servers.close()

    # -- what is wrong

    def diagnose(self, endpoint: Any) -> Problem:
        """Return what prevents peers from matching, and log it once."""
        code, reason = super().diagnose(endpoint)
        # ROS014 and ROS015 are logged once for all topics.
        if code not in ("", "ROS014", "ROS015") and self._logged.first((endpoint.topic, reason)):
            self.logger.warning("%s [%s]", reason, code)
        return code, reason

    def _judge(self, endpoint: Any) -> tuple[bool, list[Problem]]:
        if self.ended:
            return True, [("ROS015", self.ended)]
        if self._closed:
            return True, []
        met = bool(endpoint.matched)
        if isinstance(endpoint, RospySubscription):
            found = endpoint.shared.problems()
        elif isinstance(endpoint, RospyPublisher):
            found = self._strange_subscribers(endpoint.shared)
        elif isinstance(endpoint, RospyClient):
            found = [endpoint.problem] if endpoint.problem[1] else []
        else:
            met = True  # callers come and go
            others = self.servers(endpoint.topic) - {self.node}
            found = [("ROS022", f"node {other} has taken over {endpoint.topic}") for other in others]
        if trouble := self._registration.trouble:
            found.append(("ROS014", trouble))
        return met, found

    def _strange_subscribers(self, outgoing: Outgoing) -> list[Problem]:
        topic = outgoing.topic
        found = [wrong for _, wrong in list(outgoing.strangers.values())]
        named = self._registration.state.subscribers.get(topic, frozenset())
        absent = named - outgoing.subscribers() - set(outgoing.strangers)
        for node in sorted(absent):
            text = f"node {node} subscribes to {topic}, but is not connected"
            if not self._settling((topic, node), _SETTLE_NS):
                text += f"; it may be unable to reach {self.uri}: set ROS_IP or ROS_HOSTNAME"
            found.append(("", text))
        # A copy, in one step: several threads may ask at once.
        for key in [key for key in tuple(self._since) if key[0] == topic and key[1] not in absent]:  # type: ignore[index]
            self._since.pop(key, None)
        return found

    # -- looking at it

    def graph(self) -> GraphInfo:
        """Return the graph of the other nodes according to the master at most a second ago.

        ROS 1 has no quality of service; whether a publisher latches is only known after connecting.
        """
        if self._closed:
            return GraphInfo()
        state = self._registration.state
        latching = {
            (topic, link.node)
            for topic, incoming in self.having("in").items()
            for link in incoming.links()
            if link.latching
        }

        def infos(
            direction: Literal["in", "out"], table: dict[str, frozenset[str]]
        ) -> Iterator[EndpointInfo]:
            for topic, nodes in table.items():
                kind = ros2_name(state.types.get(topic, ANY))
                for node in nodes - {self.node}:
                    durable = direction == "out" and (topic, node) in latching
                    qos = Qos(durability="transient_local" if durable else "volatile", depth=1)
                    yield EndpointInfo(topic, kind, direction, node, qos)

        endpoints = (*infos("in", state.subscribers), *infos("out", state.publishers))
        calls = [
            EndpointInfo(service, ANY, "in", node, Qos(depth=1))
            for service, nodes in state.services.items()
            for node in nodes - {self.node}
        ]
        found = graph_info(state.nodes - {self.node}, endpoints, calls)
        told = {topic: tuple(kind for kind in kinds if kind != ANY) for topic, kinds in found.topics.items()}
        return replace(found, topics=told)

    def _stop(self) -> None:
        self._registration.close()

    def _leave(self) -> None:
        self._servers.close()
        for one in self._ending:
            with contextlib.suppress(RuntimeError):
                one.join()
            one.end()
        for connections in (self.inbound, self.outbound):
            connections.close()


# Connect to a ROS 1 graph; arguments and errors as for `rosplc.ros.open_backend`.
#
# ROS 1 has no domains: `ROS_MASTER_URI` selects the graph. There are no options. The call returns
# immediately, with or without a master; the node registers when a master is available.
open_backend = opener(RospyBackend)
