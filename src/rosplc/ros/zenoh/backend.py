"""The Zenoh backend: one session, one node, one receive thread over all subscriptions."""

from __future__ import annotations

import itertools
import logging
import queue
import threading
from dataclasses import replace
from typing import Any

import zenoh

from rosplc.errors import BackendError
from rosplc.ros._base import BaseNode, Context, Opener, domain_number, listed
from rosplc.ros.backend import GraphInfo, OnMessage, Qos
from rosplc.ros.zenoh.config import session_config
from rosplc.ros.zenoh.endpoint import ZenohPublisher, ZenohSubscription
from rosplc.ros.zenoh.graph import TokenTable, explain, fits
from rosplc.ros.zenoh.keys import NO_TYPE_HASH
from rosplc.ros.zenoh.session import Link
from rosplc.ros.zenoh.tokens import Entity, Kind, tokens_of_domain

__all__ = ["ZenohBackend", "open_backend"]

_logger = logging.getLogger("rosplc.ros.zenoh")

_TICK_S = 0.5  # how often the receive thread looks at what has no event of its own

ZenohEndpoint = ZenohSubscription | ZenohPublisher


class ZenohBackend(BaseNode):
    """One ROS 2 node on Zenoh; see :class:`rosplc.ros.backend.Backend`.

    Attributes:
        name: ``zenoh``.
        capabilities: ``topics``.
        domain: The ROS domain.
        node: The node's full name.
        tokens: What is seen of the graph.
    """

    name = "zenoh"
    capabilities = frozenset({"topics"})

    logger = _logger

    def __init__(self, context: Context) -> None:
        super().__init__(context)
        self._hashes = context.store.distro != "humble"
        self.domain = domain_number(context.domain, context.environment) or 0
        self.tokens = TokenTable()
        self._session: Any = None
        self._session_id = ""
        self._declared: list[Any] = []
        self._endpoints: dict[int, ZenohEndpoint] = {}
        self._numbers = itertools.count(1)
        self._arrived: queue.SimpleQueue[ZenohSubscription | None] = queue.SimpleQueue()
        self._suspects: set[str] = set()
        self._link = Link(session_config(context.options, context.environment), self._join)
        self._link.start()
        self._thread = threading.Thread(target=self._run, name=f"rosplc-zenoh-{self.domain}", daemon=True)
        self._thread.start()

    # -- joining

    def _join(self, session: Any) -> None:
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
                liveliness.declare_subscriber(tokens_of_domain(self.domain), see, history=True),
            ]
            for endpoint in self._endpoints.values():
                endpoint.declare(session, replace(endpoint.entity, session=self._session_id))

    def _entity(self, kind: Kind, number: str, *details: Any) -> Entity:
        return Entity(
            self.domain, self._session_id, "0", number, kind, self._namespace, self._node_name, *details
        )

    def _see(self, sample: Any) -> None:
        """Take in that a token has appeared or gone; called by threads of the library."""
        try:
            token = str(sample.key_expr)
            appeared = sample.kind == zenoh.SampleKind.PUT
            topic = self.tokens.appeared(token) if appeared else self.tokens.gone(token)
            if topic is not None:
                self._suspects.add(topic)
        except Exception:  # a defect; but the library would print it and go on without a word
            _logger.exception("a token could not be taken in")

    # -- endpoints

    def subscribe(self, topic: str, type_name: str, qos: Qos, on_message: OnMessage) -> ZenohSubscription:
        """Receive a topic; see :meth:`rosplc.ros.backend.Backend.subscribe`."""
        with self._lock:
            number, details = self._details(topic, type_name, qos)
            entity = self._entity("MS", str(number), *details)
            subscription = ZenohSubscription(
                on_message,
                self._arrived.put,
                entity,
                self._diagnose,
                lambda _: self._forget(number),
                self._clock,
            )
            self._adopt(number, subscription)
        return subscription

    def advertise(self, topic: str, type_name: str, qos: Qos) -> ZenohPublisher:
        """Send a topic; see :meth:`rosplc.ros.backend.Backend.advertise`."""
        with self._lock:
            number, details = self._details(topic, type_name, qos)
            entity = self._entity("MP", str(number), *details)
            publisher = ZenohPublisher(entity, self._diagnose, lambda _: self._forget(number), self._clock)
            self._adopt(number, publisher)
        return publisher

    def _details(self, topic: str, type_name: str, qos: Qos) -> tuple[int, tuple[Any, ...]]:
        full, name = self._resolve(topic, type_name)
        type_hash = self._store.type_hash(name) if self._hashes else NO_TYPE_HASH
        return next(self._numbers), (full, name, type_hash, qos)

    def _adopt(self, number: int, endpoint: ZenohEndpoint) -> None:
        if self._session is not None:
            try:
                endpoint.declare(self._session, endpoint.entity)
            except zenoh.ZError as error:
                what = f"cannot open {endpoint.topic} as {endpoint.type_name}: {error}"
                raise BackendError("ROS002", what) from error
        self._endpoints[number] = endpoint
        self._suspects.add(endpoint.topic)

    def _forget(self, number: int) -> None:
        with self._lock:
            self._endpoints.pop(number, None)

    # -- receiving

    def _run(self) -> None:
        next_tick = 0
        while True:
            try:
                subscription = self._arrived.get(timeout=_TICK_S)
                if subscription is None:
                    return
                subscription.deliver()
            except queue.Empty:
                pass
            if (now := self._clock.monotonic_ns()) >= next_tick:
                next_tick = now + round(_TICK_S * 1e9)
                self._tick()

    def _tick(self) -> None:
        try:
            self._link.look()
            self._warn()
        except Exception:  # a defect; but the topics have to go on
            _logger.exception("the receive thread of %s had an error", self.node)

    def _warn(self) -> None:
        """Say once in the log what keeps peers on a topic from matching."""
        if not self._suspects:
            return
        due, self._suspects = self._suspects, set()
        with self._lock:
            endpoints = [endpoint for endpoint in self._endpoints.values() if endpoint.topic in due]
        for endpoint in endpoints:
            for code, reason in self._problems(endpoint.entity, self._others(endpoint.entity)):
                if self._logged.first((endpoint.topic, reason)):
                    _logger.warning("%s%s", reason, f" [{code}]" if code else "")

    # -- what is wrong

    def _others(self, ours: Entity) -> tuple[Entity, ...]:
        return self.tokens.on(ours.topic, "MP" if ours.kind == "MS" else "MS")

    def _problems(self, ours: Entity, others: tuple[Entity, ...]) -> list[tuple[str, str]]:
        return sorted(filter(None, (explain(ours, theirs) for theirs in others)), reverse=True)

    def _diagnose(self, ours: Entity) -> tuple[int, str, str]:
        others = self._others(ours)
        matched = sum(fits(ours, theirs) for theirs in others)
        problems = self._problems(ours, others)
        if trouble := self._link.trouble:
            problems.append(("ROS016", trouble))
        if problems:
            return matched, max(problems)[0], listed(words for _, words in problems)
        if not others:
            verb = "publishes" if ours.kind == "MS" else "subscribes to"
            return 0, "", f"no node {verb} {ours.topic}"
        return matched, "", ""

    # -- looking at it

    def _endpoints_now(self) -> list[ZenohEndpoint]:
        return list(self._endpoints.values())

    def graph(self) -> GraphInfo:
        """Return what is seen of the other nodes."""
        return self.tokens.graph(self._session_id)

    def close(self) -> None:
        """Leave the graph; see :meth:`rosplc.ros.backend.Backend.close`."""
        with self._lock:
            if self._closed:
                return
            self._closed = True
            endpoints = list(self._endpoints.values())
        for endpoint in endpoints:
            endpoint.close()
        self._arrived.put(None)
        if threading.current_thread() is not self._thread:
            self._thread.join()
        self._link.close()
        self.tokens.clear()


open_backend = Opener(ZenohBackend)
"""Connect to a ROS 2 graph over Zenoh; arguments and errors as for :func:`rosplc.ros.open_backend`.

Options (``ros.zenoh``): ``mode`` (``peer`` or ``client``), ``connect`` and ``listen`` (lists
of endpoints such as ``tcp/192.168.1.10:7447``), ``config`` (a JSON5 file of Zenoh's). ROS013 if an option is
not valid, ROS010 if an environment variable is not.
"""
