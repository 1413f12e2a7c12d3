"""The DDS backend: one participant, one node, one receive thread over all readers."""

from __future__ import annotations

import logging
from collections.abc import Iterator
from dataclasses import replace
from typing import Any

from cyclonedds.core import DDSException
from cyclonedds.domain import DomainParticipant
from cyclonedds.pub import DataWriter
from cyclonedds.pub import Publisher as PublisherGroup
from cyclonedds.qos import Policy
from cyclonedds.qos import Qos as DdsQos
from cyclonedds.sub import DataReader
from cyclonedds.sub import Subscriber as SubscriberGroup

from rosplc.ros import _base
from rosplc.ros._base import BaseNode, Context, Problem
from rosplc.ros.backend import EndpointInfo, GraphInfo, OnMessage, Qos
from rosplc.ros.dds import domain as domains
from rosplc.ros.dds import native
from rosplc.ros.dds.domain import check_peers, domain_config, domain_id
from rosplc.ros.dds.endpoint import DdsPublisher, DdsSubscription
from rosplc.ros.dds.graph import Announcer
from rosplc.ros.dds.idl import IdlTypes, dds_topic, ros_topic
from rosplc.ros.dds.log import TRACING, library_log
from rosplc.ros.dds.peers import Peer, PeerTable

_TICK_NS = 500_000_000  # how often the receive thread looks at what has no event of its own
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
    """One ROS 2 node on DDS; see :class:`rosplc.ros.backend.Backend`."""

    name = "dds"
    capabilities = frozenset({"topics", "deadline"})
    logger = logging.getLogger("rosplc.ros.dds")

    def __init__(self, context: Context) -> None:
        super().__init__(context)
        store, environment = context.store, context.environment
        self._hashes = store.distro != "humble"
        self._types = IdlTypes(store)
        self._changed = False
        self._readers: dict[int, DdsSubscription] = {}  # by their keys in the waitset
        self._next_key = _FIRST
        self._suspects: dict[str, int] = {}
        self.domain = domain_id(context.domain, environment)
        check_peers(environment, store.distro)
        tracing = TRACING.format(library_log().path)
        domains.enter(self.domain, domain_config(environment, store.distro, tracing))
        try:
            self._connect()
        except DDSException as error:
            domains.leave(self.domain)
            raise native.refusal(f"cannot join domain {self.domain} as {self.node}", error) from error
        self._start(self._run, f"rosplc-dds-{self.domain}")

    def _connect(self) -> None:
        self._participant = DomainParticipant(self.domain, qos=DdsQos(Policy.Userdata(b"enclave=/;")))
        guid: bytes = self._participant.guid.bytes
        self._publishers = PublisherGroup(self._participant)
        self._subscribers = SubscriberGroup(self._participant)
        self._topics = domains.Topics(self._participant)
        names = (self._namespace, self._node_name, self._store.distro)
        self._announcer = Announcer(self._participant, self._topics, guid, *names, dds_qos)
        self._peers = PeerTable(self._participant, guid)
        self._waitset = native.WaitSet(self._participant._ref)
        for key, reader in enumerate(self._peers.readers):
            self._waitset.attach(reader._ref, key)
        self._waitset.attach(self._announcer.reader, _ANNOUNCEMENTS)

    # -- endpoints

    def subscribe(self, topic: str, type_name: str, qos: Qos, on_message: OnMessage) -> DdsSubscription:
        """Receive a topic; see :meth:`rosplc.ros.backend.Backend.subscribe`."""
        with self._lock:
            details = self._make(topic, type_name, qos, DataReader, "_subscribers")
            subscription = DdsSubscription(on_message, *details)
            self._adopt(subscription)
            self._find_strangers(subscription)
            self._readers[self._next_key] = subscription
            subscription.condition = self._waitset.attach(subscription.ref, self._next_key)
            self._next_key += 1
        self._waitset.wake()
        return subscription

    def advertise(self, topic: str, type_name: str, qos: Qos) -> DdsPublisher:
        """Send a topic; see :meth:`rosplc.ros.backend.Backend.advertise`."""
        with self._lock:
            publisher = DdsPublisher(*self._make(topic, type_name, qos, DataWriter, "_publishers"))
            self._adopt(publisher)
        self._waitset.wake()
        return publisher

    def _make(self, topic: str, type_name: str, qos: Qos, kind: Any, group: str) -> tuple[Any, ...]:
        """Open an entity; return the arguments of an endpoint."""
        full, name = self._resolve(topic, type_name)
        type_hash = self._store.type_hash(name) if self._hashes else ""
        try:
            native_topic = self._topics(dds_topic(full), self._types[name])
            entity = kind(getattr(self, group), native_topic, dds_qos(qos, type_hash))
        except DDSException as error:
            raise native.refusal(f"cannot open {full} as {name}", error) from error
        return entity, self, full, name, qos, type_hash

    def _adopt(self, endpoint: DdsEndpoint) -> None:
        self._endpoints.append(endpoint)
        self._announcer.add(endpoint.guid, reader=endpoint.direction == "in")
        self._changed = True
        self._suspects.setdefault(endpoint.dds_topic, self.clock.monotonic_ns())

    def forget(self, endpoint: DdsEndpoint) -> None:
        """Take in that an endpoint is being closed."""
        with self._lock:
            super().forget(endpoint)
            if isinstance(endpoint, DdsSubscription):
                self._readers = {key: one for key, one in self._readers.items() if one is not endpoint}
                self._waitset.detach(endpoint.condition)
            self._announcer.remove(endpoint.guid)
            for pair in [pair for pair in self._since if pair[0] == endpoint.guid]:  # type: ignore[index]
                del self._since[pair]
            self._changed = True
        self._waitset.wake()

    # -- receiving

    def _run(self) -> None:
        wait = self._waitset.wait
        next_tick = 0
        while not self._closed:
            try:
                for key in sorted(wait(_TICK_NS)):  # who the peers are, before what they say
                    if key >= _FIRST:
                        if (subscription := self._readers.get(key)) is not None:
                            subscription.take()
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
                if (now := self.clock.monotonic_ns()) >= next_tick:
                    next_tick = now + _TICK_NS
                    library_log().drain()
                    self._tick(now)
            except Exception:  # a defect; but the other topics have to go on
                self.logger.exception("the receive thread of %s had an error", self.node)
                self.clock.sleep(100_000_000)

    def _look(self, which: int) -> None:
        with self._lock:
            changed = self._peers.update(which)
            self._suspects |= dict.fromkeys(changed, self.clock.monotonic_ns())
            for subscription in self._readers.values():
                if subscription.dds_topic in changed:
                    self._find_strangers(subscription)

    def _find_strangers(self, subscription: DdsSubscription) -> None:
        subscription.strangers = frozenset(
            peer.handle
            for peer in self._peers.on(subscription.dds_topic, "out")
            if _base.differs(peer.info.type_hash, subscription.type_hash)
        )

    # -- what is wrong

    def _tick(self, now: int) -> None:
        with self._lock:
            due = {topic for topic, since in self._suspects.items() if now - since >= _base.SETTLE_NS}
            self._suspects = {topic: since for topic, since in self._suspects.items() if topic not in due}
            endpoints = [endpoint for endpoint in self._endpoints if endpoint.dds_topic in due]
        for endpoint in endpoints:
            self._warn(endpoint)

    def _judge(self, endpoint: DdsEndpoint) -> tuple[bool, list[Problem]]:
        peers = self._peers.on(endpoint.dds_topic, "out" if endpoint.direction == "in" else "in")
        matched = endpoint.matched_handles()
        problems = (self._explain(endpoint, peer, peer.handle in matched) for peer in peers)
        return bool(peers or matched), [*filter(None, problems)]

    def _explain(self, endpoint: DdsEndpoint, peer: Peer, matched: bool) -> Problem | None:
        """Judge a peer.

        If one does not match that should by all that is announced, the definitions differ; but discovery and
        matching lag a moment behind each other when a peer comes or goes, so this is reported only once it
        has lasted.
        """
        node = self._announcer.node_of(peer.guid)
        name = f"node {node}" if node else f"a DDS participant without a ROS node ({peer.guid[:12].hex()})"
        if problem := _base.explain(peer.info, endpoint, name, matched=matched):
            return problem
        key = (endpoint.guid, peer.guid)
        if matched:
            self._since.pop(key, None)
            return None
        if self._settling(key):
            self._suspects.setdefault(peer.dds_topic, self.clock.monotonic_ns())
            return "", f"{_base.describe(peer.info, name)}, not matched yet"
        return "ROS003", f"{_base.describe(peer.info, name)} with another definition"

    def graph(self) -> GraphInfo:
        """Return what is seen of the other nodes."""

        def infos() -> Iterator[EndpointInfo]:
            for peer in self._peers.all():
                if ros_topic(peer.dds_topic) is not None:
                    yield replace(peer.info, node=self._announcer.node_of(peer.guid))

        return _base.graph_info(self._announcer.nodes(), infos())

    def _stop(self) -> None:
        self._waitset.wake()
        self._join()

    def _leave(self) -> None:
        self._announcer.close()
        self._waitset.close()
        self._topics.close()
        for entity in (*self._peers.readers, self._publishers, self._subscribers, self._participant):
            native.delete(entity)
        domains.leave(self.domain)


# Connect to a ROS 2 graph; arguments and errors as for `rosplc.ros.open_backend`; no options.
open_backend = _base.opener(DdsBackend)
