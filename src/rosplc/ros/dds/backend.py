"""The DDS backend: one participant, one node, one receive thread over all readers."""

from __future__ import annotations

import logging
import threading
from collections.abc import Iterator
from typing import Any, Literal

from cyclonedds.core import DDSException
from cyclonedds.domain import DomainParticipant
from cyclonedds.pub import DataWriter
from cyclonedds.pub import Publisher as PublisherGroup
from cyclonedds.qos import Policy
from cyclonedds.qos import Qos as DdsQos
from cyclonedds.sub import DataReader
from cyclonedds.sub import Subscriber as SubscriberGroup

from rosplc.ros._base import BaseNode, Context, Opener, graph_info, listed
from rosplc.ros.backend import EndpointInfo, GraphInfo, OnMessage, Qos
from rosplc.ros.dds import domain as domains
from rosplc.ros.dds import native
from rosplc.ros.dds.config import check_peers, domain_config, domain_id
from rosplc.ros.dds.endpoint import DdsPublisher, DdsSubscription
from rosplc.ros.dds.graph import Announcer
from rosplc.ros.dds.idl import IdlTypes, dds_topic, ros_topic, ros_type_name
from rosplc.ros.dds.log import TRACING, library_log
from rosplc.ros.dds.peers import Peer, PeerTable, describe, differs, explain

__all__ = ["DdsBackend", "open_backend"]

_logger = logging.getLogger("rosplc.ros.dds")

_TICK_NS = 500_000_000  # how often the receive thread looks at what has no event of its own
_SETTLE_NS = 1_000_000_000  # matching may take a moment; nothing is called a mismatch before
_PARTICIPANTS, _ANNOUNCEMENTS, _FIRST = 2, 3, 4  # keys in the waitset; 0 and 1 are endpoints of peers

DdsEndpoint = DdsSubscription | DdsPublisher


def dds_qos(qos: Qos, type_hash: str) -> DdsQos:
    """Return the wheel's QoS for an endpoint, as ``rmw_cyclonedds_cpp`` would set it.

    One difference: a reliable writer waits for no peer. The wheel holds the GIL while it
    writes, so one slow peer would stop every topic of the bridge.
    """
    transient = qos.durability == "transient_local"
    policies = [
        Policy.Reliability.Reliable(0) if qos.reliability == "reliable" else Policy.Reliability.BestEffort,
        Policy.History.KeepLast(qos.depth),
        Policy.Durability.TransientLocal if transient else Policy.Durability.Volatile,
        Policy.DataRepresentation(use_cdrv0_representation=True),
        Policy.WriterDataLifecycle(autodispose=False),
    ]
    if transient:
        policies.append(Policy.DurabilityService(0, Policy.History.KeepLast(qos.depth), -1, -1, -1))
    if qos.deadline_ns:
        policies.append(Policy.Deadline(qos.deadline_ns))
    if qos.lease_ns:
        policies.append(Policy.Liveliness.Automatic(qos.lease_ns))
    if type_hash:
        policies.append(Policy.Userdata(f"typehash={type_hash};".encode()))
    return DdsQos(*policies)


class DdsBackend(BaseNode):
    """One ROS 2 node on DDS; see :class:`rosplc.ros.backend.Backend`.

    Attributes:
        name: ``dds``.
        capabilities: ``topics`` and ``deadline``.
        domain: The ROS domain.
        node: The node's full name.
    """

    name = "dds"
    capabilities = frozenset({"topics", "deadline"})

    logger = _logger

    def __init__(self, context: Context) -> None:
        super().__init__(context)
        store, environment = context.store, context.environment
        self._hashes = store.distro != "humble"
        self._types = IdlTypes(store)
        self._changed = False
        self._endpoints: dict[int, DdsEndpoint] = {}
        self._next_key = _FIRST
        self._suspects: dict[str, int] = {}
        self._unmatched: dict[tuple[bytes, bytes], int] = {}
        self.domain = domain_id(context.domain, environment)
        check_peers(environment, store.distro)
        tracing = TRACING.format(library_log().path)
        domains.enter(self.domain, domain_config(environment, store.distro, tracing))
        try:
            self._join()
        except DDSException as error:
            domains.leave(self.domain)
            raise native.refusal(f"cannot join domain {self.domain} as {self.node}", error) from error
        self._thread = threading.Thread(target=self._run, name=f"rosplc-dds-{self.domain}", daemon=True)
        self._thread.start()

    def _join(self) -> None:
        self._participant = DomainParticipant(self.domain, qos=DdsQos(Policy.Userdata(b"enclave=/;")))
        guid: bytes = self._participant.guid.bytes
        self._publishers = PublisherGroup(self._participant)
        self._subscribers = SubscriberGroup(self._participant)
        self._topics = domains.Topics(self._participant)
        self._announcer = Announcer(
            self._participant,
            self._topics,
            guid,
            self._namespace,
            self._node_name,
            self._store.distro,
            dds_qos,
        )
        self._peers = PeerTable(self._participant, guid)
        self._waitset = native.WaitSet(self._participant._ref)
        for key, reader in enumerate(self._peers.readers):
            self._waitset.attach(reader._ref, key)
        self._waitset.attach(self._announcer.reader, _ANNOUNCEMENTS)

    # -- endpoints

    def subscribe(self, topic: str, type_name: str, qos: Qos, on_message: OnMessage) -> DdsSubscription:
        """Receive a topic; see :meth:`rosplc.ros.backend.Backend.subscribe`."""
        with self._lock:
            details = self._make(topic, type_name, qos, DataReader, lambda: self._subscribers)
            subscription = DdsSubscription(on_message, *details)
            key = self._adopt(subscription)
            subscription.condition = self._waitset.attach(subscription._ref, key)
        self._waitset.wake()
        return subscription

    def advertise(self, topic: str, type_name: str, qos: Qos) -> DdsPublisher:
        """Send a topic; see :meth:`rosplc.ros.backend.Backend.advertise`."""
        with self._lock:
            publisher = DdsPublisher(*self._make(topic, type_name, qos, DataWriter, lambda: self._publishers))
            self._adopt(publisher)
        self._waitset.wake()
        return publisher

    def _make(self, topic: str, type_name: str, qos: Qos, kind: Any, group: Any) -> tuple[Any, ...]:
        """Open an entity; return the arguments of an endpoint."""
        full, name = self._resolve(topic, type_name)
        type_hash = self._store.type_hash(name) if self._hashes else ""
        try:
            entity = kind(group(), self._topics(dds_topic(full), self._types[name]), dds_qos(qos, type_hash))
        except DDSException as error:
            raise native.refusal(f"cannot open {full} as {name}", error) from error
        return full, name, qos, self._forget, self._clock, entity, type_hash, self._diagnose

    def _adopt(self, endpoint: DdsEndpoint) -> int:
        key = self._next_key
        self._next_key += 1
        self._endpoints[key] = endpoint
        self._announcer.add(endpoint.guid, reader=isinstance(endpoint, DdsSubscription))
        self._changed = True
        self._suspects.setdefault(dds_topic(endpoint.topic), self._clock.monotonic_ns())
        self._find_strangers(endpoint)
        return key

    def _forget(self, endpoint: DdsEndpoint) -> None:
        with self._lock:
            for key, known in list(self._endpoints.items()):
                if known is endpoint:
                    del self._endpoints[key]
            if isinstance(endpoint, DdsSubscription):
                self._waitset.detach(endpoint.condition)
            self._announcer.remove(endpoint.guid)
            for pair in [pair for pair in self._unmatched if pair[0] == endpoint.guid]:
                del self._unmatched[pair]
            self._changed = True
        self._waitset.wake()

    # -- receiving

    def _run(self) -> None:
        wait, endpoints = self._waitset.wait, self._endpoints
        next_tick = 0
        while not self._closed:
            try:
                for key in sorted(wait(_TICK_NS)):  # who the peers are, before what they say
                    if key >= _FIRST:
                        if (endpoint := endpoints.get(key)) is not None:
                            endpoint.take()  # type: ignore[union-attr]
                    elif key == _ANNOUNCEMENTS:
                        self._announcer.take()
                    elif key == _PARTICIPANTS:
                        for participant in self._peers.gone():
                            self._announcer.forget(participant)
                    else:
                        self._look(key)
                if self._changed:
                    self._changed = False
                    self._announcer.announce()
                if (now := self._clock.monotonic_ns()) >= next_tick:
                    next_tick = now + _TICK_NS
                    library_log().drain()
                    self._warn(now)
            except Exception:  # a defect; but the other topics have to go on
                _logger.exception("the receive thread of %s had an error", self.node)
                self._clock.sleep(100_000_000)

    def _look(self, which: int) -> None:
        now = self._clock.monotonic_ns()
        with self._lock:
            changed = self._peers.update(which)
            for topic in changed:
                self._suspects[topic] = now
            for endpoint in self._endpoints.values():
                if dds_topic(endpoint.topic) in changed:
                    self._find_strangers(endpoint)

    def _find_strangers(self, endpoint: DdsEndpoint) -> None:
        if isinstance(endpoint, DdsSubscription):
            endpoint.strangers = frozenset(
                peer.handle
                for peer in self._peers.on(dds_topic(endpoint.topic), writers=True)
                if differs(peer.type_hash, endpoint.type_hash)
            )

    # -- what is wrong

    def _warn(self, now: int) -> None:
        """Say once in the log what keeps peers on a topic from matching."""
        with self._lock:
            due = {topic for topic, since in self._suspects.items() if now - since >= _SETTLE_NS}
            for topic in due:
                del self._suspects[topic]
            endpoints = [(k, e) for k, e in self._endpoints.items() if dds_topic(e.topic) in due]
        for key, endpoint in endpoints:
            code, reason = self._diagnose(endpoint)
            if code and self._logged.first((key, reason)):
                _logger.warning("%s [%s]", reason, code)

    def _diagnose(self, endpoint: DdsEndpoint) -> tuple[str, str]:
        incoming = endpoint.direction == "in"
        peers = self._peers.on(dds_topic(endpoint.topic), writers=incoming)
        matched = endpoint.matched_handles()
        found: dict[str, list[str]] = {}
        for peer in peers:
            name, fits = self._call(peer.guid), peer.handle in matched
            problem = explain(peer, name, endpoint.type_name, endpoint.type_hash, endpoint.qos, fits)
            if problem is None:
                problem = self._unexplained(endpoint, peer, name, fits)
            if problem is not None:
                found.setdefault(problem[0], []).append(problem[1])
        if found:
            return max(found), listed(sorted(text for texts in found.values() for text in texts))
        if not peers and not matched:
            return "", f"no node {'publishes' if incoming else 'subscribes to'} {endpoint.topic}"
        return "", ""

    def _unexplained(
        self, endpoint: DdsEndpoint, peer: Peer, name: str, fits: bool
    ) -> tuple[str, str] | None:
        """Judge a peer that should match by all that is announced.

        If it does not, the definitions differ; but discovery and matching lag a moment behind each
        other when a peer comes or goes, so this is said only of what stays so.
        """
        key = (endpoint.guid, peer.guid)
        if fits:
            self._unmatched.pop(key, None)
            return None
        now = self._clock.monotonic_ns()
        if now - self._unmatched.setdefault(key, now) < _SETTLE_NS:
            self._suspects.setdefault(peer.topic, now)
            return "", f"{describe(peer, name)}, not matched yet"
        return "ROS003", f"{describe(peer, name)} with another definition"

    def _call(self, guid: bytes) -> str:
        name = self._announcer.node_of(guid)
        return f"node {name}" if name else f"a DDS participant without a ROS node ({guid[:12].hex()})"

    # -- looking at it

    def _endpoints_now(self) -> list[DdsEndpoint]:
        return list(self._endpoints.values())

    def graph(self) -> GraphInfo:
        """Return what is seen of the other nodes."""

        def infos() -> Iterator[EndpointInfo]:
            for peer in self._peers.all():
                if (topic := ros_topic(peer.topic)) is not None:
                    kind, node = ros_type_name(peer.type_name), self._announcer.node_of(peer.guid)
                    way: Literal["in", "out"] = "out" if peer.writer else "in"
                    yield EndpointInfo(topic, kind, way, node, peer.qos, peer.type_hash, peer.obstacles)

        return graph_info(self._announcer.nodes(), infos())

    def close(self) -> None:
        """Leave the graph; see :meth:`rosplc.ros.backend.Backend.close`."""
        with self._lock:
            if self._closed:
                return
            self._closed = True
            endpoints = list(self._endpoints.values())
        self._waitset.wake()
        if threading.current_thread() is not self._thread:
            self._thread.join()
        for endpoint in endpoints:
            endpoint.close()
        self._announcer.close()
        self._waitset.close()
        self._topics.close()
        for entity in (*self._peers.readers, self._publishers, self._subscribers, self._participant):
            native.delete(entity)
        domains.leave(self.domain)


open_backend = Opener(DdsBackend)
"""Connect to a ROS 2 graph; arguments and errors as for :func:`rosplc.ros.open_backend`; no options."""
