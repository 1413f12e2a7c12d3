"""The Zenoh backend: one session, one node, one receive thread over all subscriptions."""

from __future__ import annotations

import itertools
import logging
import queue
from dataclasses import replace
from typing import Any

import zenoh

from rosplc.errors import BackendError
from rosplc.ros._base import BaseNode, Context, Problem, domain_number, opener, several
from rosplc.ros.backend import GraphInfo, Qos
from rosplc.ros.zenoh.endpoint import Endpoint, ZenohPublisher, ZenohSubscription
from rosplc.ros.zenoh.keys import NO_TYPE_HASH, OTHER, SPACE, Entity, Kind, TokenTable, explain
from rosplc.ros.zenoh.service import ZenohClient, ZenohServer
from rosplc.ros.zenoh.session import Link, session_config

_LETTERS: tuple[Kind, ...] = ("MS", "MP", "SS", "SC")
_TICK_S = 0.5  # how often the receive thread looks at what has no event of its own


class ZenohBackend(BaseNode):
    """One ROS 2 node on Zenoh; see :class:`rosplc.ros.backend.Backend`."""

    name = "zenoh"
    _kinds = (ZenohSubscription, ZenohPublisher, ZenohServer, ZenohClient)
    logger = logging.getLogger("rosplc.ros.zenoh")

    def __init__(self, context: Context) -> None:
        super().__init__(context)
        self._hashes = context.store.distro != "humble"
        self.domain = domain_number(context.domain, context.environment) or 0
        self.tokens = TokenTable()
        self._session: Any = None
        self._session_id = ""
        self._declared: list[Any] = []
        self._numbers = itertools.count(1)
        self._arrived: queue.SimpleQueue[Any] = queue.SimpleQueue()
        self.wake = self._arrived.put
        self._suspects: set[str] = set()
        config = session_config(context.options, context.environment)
        self._link = Link(config, self._connected, self.clock)
        self._link.start()
        self._start(self._run, f"rosplc-zenoh-{self.domain}")

    def _connected(self, session: Any) -> None:
        """Declare the node, listen for the others, declare the endpoints that have been asked for."""
        with self._lock:
            if self._closed:
                return
            self._session, self._session_id = session, str(session.zid())
            node = self._entity("NN", "0")
            # "Direct": otherwise the library starts a thread; and our own tokens come this way, too.
            see = zenoh.handlers.Callback(self._see, None, indirect=False)  # 1.5 has no default there
            liveliness = session.liveliness()
            self._declared = [
                liveliness.declare_token(node.token),
                liveliness.declare_subscriber(f"{SPACE}/{self.domain}/**", see, history=True),
            ]
            for endpoint in self._endpoints:
                endpoint.declare(session, replace(endpoint.entity, session=self._session_id))

    def _entity(self, kind: Kind, number: str, *details: Any) -> Entity:
        names = (self._namespace, self._node_name)
        return Entity(self.domain, self._session_id, "0", number, kind, *names, *details)

    def _see(self, sample: Any) -> None:
        """Take in that a token has appeared or gone; called by threads of the library."""
        try:
            token = str(sample.key_expr)
            appeared = sample.kind == zenoh.SampleKind.PUT
            topic = self.tokens.appeared(token) if appeared else self.tokens.gone(token)
            if topic is not None:
                self._suspects.add(topic)
        except Exception:  # a defect; but the library would print it and continue silently
            self.logger.exception("a token could not be taken in")

    # -- endpoints

    def _open(self, kind: Any, topic: str, type_name: str, qos: Qos, *receiver: Any) -> Any:
        with self._lock:
            full, name = self._resolve(topic, type_name)
            details = (full, name, self._hash(name) if self._hashes else NO_TYPE_HASH, qos)
            letters = _LETTERS[self._kinds.index(kind)]
            endpoint = kind(*receiver, self, self._entity(letters, str(next(self._numbers)), *details))
            self._adopt(endpoint)
        return endpoint

    def _adopt(self, endpoint: Endpoint) -> None:
        if self._session is not None:
            try:
                endpoint.declare(self._session, endpoint.entity)
            except zenoh.ZError as error:
                what = f"cannot open {endpoint.topic} as {endpoint.type_name}: {error}"
                raise BackendError("ROS002", what) from error
        self._endpoints.append(endpoint)
        self._suspects.add(endpoint.topic)

    # -- receiving

    def _run(self) -> None:
        next_tick = 0
        while True:
            try:
                endpoint = self._arrived.get(timeout=_TICK_S)
                if endpoint is None:
                    return
                endpoint.deliver_next()
            except queue.Empty:
                pass
            if (now := self.clock.monotonic_ns()) >= next_tick:
                next_tick = now + round(_TICK_S * 1e9)
                self._tick()

    def _tick(self) -> None:
        try:
            self._link.look()
            due, self._suspects = self._suspects, set()
            for endpoint in self.endpoints() if due else ():
                if endpoint.topic in due:
                    self._log(endpoint)
        except Exception:  # a defect; but the topics have to go on
            self.logger.exception("the receive thread of %s had an error", self.node)

    def _log(self, endpoint: Endpoint) -> None:
        for code, reason in self._problems(endpoint.entity):
            if self._logged.first((endpoint.topic, reason)):
                self.logger.warning("%s%s", reason, f" [{code}]" if code else "")

    # -- what is wrong

    def others(self, ours: Entity) -> tuple[Entity, ...]:
        """Return the endpoints that ours may exchange messages with."""
        return self.tokens.on(ours.topic, OTHER[ours.kind])

    def _problems(self, ours: Entity) -> list[Problem]:
        return sorted(filter(None, (explain(ours, theirs) for theirs in self.others(ours))), reverse=True)

    def _judge(self, endpoint: Endpoint) -> tuple[bool, list[Problem]]:
        trouble = self._link.trouble
        problems = [*self._problems(endpoint.entity), *([("ROS016", trouble)] if trouble else ())]
        if endpoint.serves:
            servers = self.tokens.on(endpoint.topic, "SS")
            others = [f"node {one.full_name}" for one in servers if one.token != endpoint.entity.token]
            problems += filter(None, [several(endpoint, others)])
        return bool(self.others(endpoint.entity)), problems

    def graph(self) -> GraphInfo:
        """Return what is seen of the other nodes."""
        return self.tokens.graph(self._session_id)

    def _leave(self) -> None:
        self._arrived.put(None)
        self._join()
        self._link.close()
        self.tokens.clear()


# Connect to a ROS 2 graph over Zenoh; arguments and errors as for `rosplc.ros.open_backend`.
#
# Options (`ros.zenoh`): `mode` (`peer` or `client`), `connect` and `listen` (lists
# of endpoints such as `tcp/192.168.1.10:7447`), `config` (a JSON5 file of Zenoh's). ROS013 if an option is
# not valid, ROS010 if an environment variable is not.
open_backend = opener(ZenohBackend)
