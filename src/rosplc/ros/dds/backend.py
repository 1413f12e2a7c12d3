"""The DDS backend: one participant, one node, one receive thread over all readers."""

from __future__ import annotations

import itertools
import logging
import os
import socket
import threading
from array import array
from collections import deque
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Any

from cyclonedds.core import DDSException
from cyclonedds.domain import Domain, DomainParticipant
from cyclonedds.pub import DataWriter
from cyclonedds.pub import Publisher as PublisherGroup
from cyclonedds.qos import Policy
from cyclonedds.qos import Qos as DdsQos
from cyclonedds.sub import DataReader
from cyclonedds.sub import Subscriber as SubscriberGroup
from cyclonedds.topic import Topic

from rosplc.errors import BackendError
from rosplc.ros import _base
from rosplc.ros._base import BaseNode, Context, Problem, domain_number
from rosplc.ros.backend import EndpointInfo, GraphInfo, Qos
from rosplc.ros.dds import native
from rosplc.ros.dds._batch import Inlet, changed
from rosplc.ros.dds.batches import obstacle
from rosplc.ros.dds.endpoint import DdsPublisher, DdsSubscription, Endpoint
from rosplc.ros.dds.idl import IdlTypes, dds_topic, service_topics
from rosplc.ros.dds.native import TRACING, library_log
from rosplc.ros.dds.peers import Announcer, Peer, PeerTable
from rosplc.ros.dds.service import DdsClient, DdsServer

MAX_DOMAIN = 232  # above, port numbers exceed 65535 (DDSI-RTPS 2.2, 9.6.1.1)

# Cyclone looks at a limited number of participants per machine; rmw_cyclonedds_cpp chooses 32.
_INDICES = "<ParticipantIndex>auto</ParticipantIndex><MaxAutoParticipantIndex>32</MaxAutoParticipantIndex>"

# Type information of Fast DDS (1.15) and Cyclone (1.16) peers is not compared: what their newer releases
# announce for ROS types does not equal what an IDL compiler makes of the same definition, and types with a
# sequence or an array would not match. Definitions are compared by ROS's own type hash instead (peers.py).
_COMPATIBILITY = "<Compatibility><IgnoreTypeInformation>1.15,1.16</IgnoreTypeInformation></Compatibility>"

# A burst must fit into a subscriber's receive buffer, by default 212,992 bytes on Linux with Fast DDS, whose
# size Cyclone takes to be its own. So repetitions go out in small bursts, and soon; the queue for them
# holds a large message. Fast DDS finds an endpoint that has gone by its key hash, which Cyclone leaves out by
# default: without it Fast DDS 3.2.3 counts endpoints that were closed until the whole participant has gone.
_INTERNAL = (
    "<Internal><GenerateKeyhash>true</GenerateKeyhash><BurstSize><MaxRexmit>64KiB</MaxRexmit></BurstSize>"
    "<MaxQueuedRexmitBytes>16MB</MaxQueuedRexmitBytes><MaxQueuedRexmitMessages>20000</MaxQueuedRexmitMessages>"
    '<HeartbeatInterval max="100ms">20ms</HeartbeatInterval></Internal>'
)

# Cyclone's own is 8 s: so long a Fast DDS node takes to find a bridge again whose network was down for longer
# than the lease of 10 s.
_ANNOUNCING = "<SPDPInterval>2s</SPDPInterval>"

_RANGES = ("SUBNET", "LOCALHOST", "OFF", "SYSTEM_DEFAULT")


def domain_id(domain: int | None, environment: Mapping[str, str]) -> int:
    """Return the domain: the given one, else ``ROS_DOMAIN_ID``, else 0; ROS010 unless it is 0 to 232."""
    return domain_number(domain, environment, MAX_DOMAIN) or 0


def _discovery_range(environment: Mapping[str, str]) -> str:
    local = environment.get("ROS_LOCALHOST_ONLY") or "0"
    if local not in ("0", "1"):
        what = f"ROS_LOCALHOST_ONLY is {local!r}; it must be 0 or 1"
        raise BackendError("ROS010", what, where="ROS_LOCALHOST_ONLY")
    if local == "1":  # older, but where it is set it wins (rcl, discovery_options.c)
        return "LOCALHOST"
    name = "ROS_AUTOMATIC_DISCOVERY_RANGE"
    value = environment.get(name) or "SUBNET"
    if value not in _RANGES:
        raise BackendError("ROS010", f"{name} is {value!r}; use one of {', '.join(_RANGES)}", where=name)
    return value


def _peers(addresses: list[str]) -> str:
    # As xml.sax.saxutils.quoteattr, which imports what talks HTTP over TLS.
    quoted = (each.replace("&", "&amp;").replace("<", "&lt;").replace('"', "&quot;") for each in addresses)
    return "<Peers>" + "".join(f'<Peer address="{address}"/>' for address in quoted) + "</Peers>"


def _interfaces(environment: Mapping[str, str], *, beyond: bool) -> str:
    """Return the interfaces of a node that discovers other nodes on this machine."""
    # Peers on older releases of Cyclone, and on Fast DDS, announce themselves to 127.0.0.1 alone, and this
    # release takes no announcement from an interface that it does not use. Lists of interfaces add up, so one
    # in the user's configuration must be the only one.
    if "NetworkInterface" in environment.get("CYCLONEDDS_URI", ""):
        return ""
    others = '<NetworkInterface autodetermine="true"/>' if beyond else ""
    return f'<Interfaces>{others}<NetworkInterface address="127.0.0.1"/></Interfaces>'


def domain_config(environment: Mapping[str, str], distro: str, extra: str = "") -> str:
    """Return the configuration for ``dds_create_domain``: comma-separated XML fragments, with ``extra``.

    ROS environment variables have the same effect as in ``rmw_cyclonedds_cpp``. The user's
    ``CYCLONEDDS_URI`` comes last and takes precedence.
    """
    # Humble does not look at the newer variables; a value that ROS does not know is ROS010.
    humble = distro == "humble"
    if humble:
        environment = {key: value for key, value in environment.items() if key not in _NOT_HUMBLE}
    reach = _discovery_range(environment)
    static = _static_peers(environment)
    general, discovery = "", ""
    if reach == "LOCALHOST":
        general = "<AllowMulticast>false</AllowMulticast>" + _interfaces(environment, beyond=bool(static))
        discovery = _INDICES + _peers(["localhost", *static])
    elif reach == "OFF":
        general = "<AllowMulticast>false</AllowMulticast>"
        # Nobody else uses this tag, so that nobody is discovered, and no participant index is used up.
        discovery = f"<ParticipantIndex>none</ParticipantIndex><Tag>ros_discovery_off_{os.getpid()}</Tag>"
    elif reach == "SUBNET":
        discovery = _INDICES + (_peers(static) if static else "")
    own = (
        '<CycloneDDS><Domain id="any">'
        + (f"<General>{general}</General>" if general else "")
        + f"<Discovery>{discovery}{_ANNOUNCING}</Discovery>"
        + f"{_COMPATIBILITY}{_INTERNAL}{extra}</Domain></CycloneDDS>"
    )
    users = environment.get("CYCLONEDDS_URI", "").strip()
    if not users.isascii():
        raise BackendError("ROS010", "CYCLONEDDS_URI contains non-ASCII characters", where="CYCLONEDDS_URI")
    return f"{own},{users}" if users else own


_NOT_HUMBLE = ("ROS_AUTOMATIC_DISCOVERY_RANGE", "ROS_STATIC_PEERS")


def check_peers(environment: Mapping[str, str], distro: str) -> None:
    """Refuse (ROS010) a static peer without an address, for which the library would abort the process."""
    users = environment.get("CYCLONEDDS_URI", "")
    if distro == "humble" or "udp6" in users or "IPv6" in users:
        return  # not looked at; or other addresses are fine
    if _discovery_range(environment) not in ("SUBNET", "LOCALHOST"):
        return
    for peer in _static_peers(environment):
        host, _, port = peer.partition(":")
        try:
            if not port or port.isdigit():
                socket.getaddrinfo(host, None, socket.AF_INET)
                continue
            why = "it must be HOST or HOST:PORT"
        except (OSError, UnicodeError) as error:
            why = getattr(error, "strerror", None) or str(error)
        what = f"ROS_STATIC_PEERS contains {peer!r}: {why}"
        raise BackendError("ROS010", what, where="ROS_STATIC_PEERS")


def _static_peers(environment: Mapping[str, str]) -> list[str]:
    if environment.get("ROS_LOCALHOST_ONLY") == "1":
        return []
    return [*filter(None, map(str.strip, environment.get("ROS_STATIC_PEERS", "").split(";")))]


_logger = logging.getLogger("rosplc.ros.dds")


# Held while types come and go.
#
# Creating a topic, the wheel walks the type library without the library's lock (cyclonedds 11.0.1; the report
# is tests/interop/upstream/cyclonedds_types.md): whatever removes a type at that moment ends the process.
TYPES = threading.RLock()


class Topics:
    """A participant's topics, each opened once and kept: no type is removed while the participant exists."""

    def __init__(self, participant: Any) -> None:
        self._participant = participant
        self._open: dict[tuple[str, Any], Any] = {}

    def __call__(self, name: str, data_type: Any) -> Any:
        """Return the topic with this name and type; DDSException if the library refuses it."""
        with TYPES:
            if (name, data_type) not in self._open:
                self._open[name, data_type] = Topic(self._participant, name, data_type)
            return self._open[name, data_type]

    def close(self) -> None:
        """Delete the topics."""
        with TYPES:
            while self._open:
                native.delete(self._open.popitem()[1])


@dataclass
class _Entry:
    domain: Any
    config: str
    users: int = 1


_domains: dict[int, _Entry] = {}
_lock = threading.Lock()


def enter(number: int, config: str) -> None:
    """Make sure that a domain exists; a new one gets this configuration. Raises ROS002."""
    with _lock, TYPES:
        if (entry := _domains.get(number)) is not None:
            entry.users += 1
            if entry.config != config:
                text = "domain %d is already open with another configuration, which remains in effect"
                _logger.warning(text, number)
            return
        try:
            _domains[number] = _Entry(Domain(number, config), config)
        except DDSException as error:
            if error.code == DDSException.DDS_RETCODE_PRECONDITION_NOT_MET:
                text = "domain %d was opened by other code in this process, whose configuration applies"
                _logger.warning(text, number)
                return
            remedy = "Check CYCLONEDDS_URI and the network interfaces; the library's message is on stderr."
            raise native.refusal(f"cannot join domain {number}", error, remedy=remedy) from error


def leave(number: int) -> None:
    """Release a domain; the last release deletes it."""
    with _lock, TYPES:
        entry = _domains.get(number)
        if entry is None:
            return
        entry.users -= 1
        if entry.users == 0:
            del _domains[number]
            native.delete(entry.domain)


_TICK_NS = 500_000_000  # how often the receive thread looks at what has no event of its own
_SHORT_NS = 10_000_000  # the same while a response waits for its reader
_DECOYS = "rosplc_nothing"  # the partition of the writers that nothing matches (service.py)
_PARTICIPANTS, _ANNOUNCEMENTS, _FIRST = 2, 3, 4  # keys in the waitset; 0 and 1 are endpoints of peers
_FOREIGN = "over a DDS implementation whose service calls are incompatible with Cyclone DDS"


def dds_qos(qos: Qos, type_hash: str, service_id: str = "") -> DdsQos:
    """Return the wheel's QoS for an endpoint, as ``rmw_cyclonedds_cpp`` would set it."""
    # One difference: a reliable writer waits for no peer. The wheel holds the GIL while it writes, so one
    # slow peer would stop every topic of the bridge.
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
    if qos.lifespan_ns:
        policies.append(Policy.Lifespan(qos.lifespan_ns))
    user_data = service_id + (f"typehash={type_hash};" if type_hash else "")
    if user_data:
        policies.append(Policy.Userdata(user_data.encode()))
    return DdsQos(*policies)


class DdsBackend(BaseNode):
    """One ROS 2 node on DDS; see :class:`rosplc.ros.backend.Backend`."""

    name = "dds"
    capabilities = frozenset({"topics", "services", "deadline"})
    _kinds = (DdsSubscription, DdsPublisher, DdsServer, DdsClient)
    logger = logging.getLogger("rosplc.ros.dds")

    def __init__(self, context: Context) -> None:
        super().__init__(context)
        store, environment = context.store, context.environment
        self._hashes = store.distro != "humble"
        self._types = IdlTypes(store)
        self._changed = False
        self._reviewed: set[str] = set()  # the topics of DDS of which peers may have changed
        self._watched: tuple[tuple[Endpoint, ...], Any] = ((), array("i"))  # what shows their changes
        self._readers: dict[int, Any] = {}  # by their keys in the waitset
        self._keys = itertools.cycle(range(_FIRST, 1 << 16))
        self._service_ids = itertools.count(1)
        self._hurried: deque[DdsServer] = deque()  # those whose responses wait
        self._suspects: dict[str, int] = {}
        self.domain = domain_id(context.domain, environment)
        check_peers(environment, store.distro)
        tracing = TRACING.format(library_log.path)
        enter(self.domain, domain_config(environment, store.distro, tracing))
        try:
            self._connect()
        except DDSException as error:
            leave(self.domain)
            raise native.refusal(f"cannot join domain {self.domain} as {self.node}", error) from error
        self._start(self._run, f"rosplc-dds-{self.domain}")

    def _connect(self) -> None:
        self._participant = DomainParticipant(self.domain, qos=DdsQos(Policy.Userdata(b"enclave=/;")))
        guid: bytes = self._participant.guid.bytes
        self._guid = guid
        self._publishers = PublisherGroup(self._participant)
        self._decoys = PublisherGroup(self._participant, qos=DdsQos(Policy.Partition([_DECOYS])))
        self._subscribers = SubscriberGroup(self._participant)
        self._topics = Topics(self._participant)
        names = (self._namespace, self._node_name, self._store)
        self._announcer = Announcer(self._participant, self._topics, guid, *names, dds_qos)
        self.peers = PeerTable(self._participant, guid)
        with TYPES:
            self.warnings = (*filter(None, [obstacle()]),)  # for the bridge's status
        self._inlet = None if self.warnings else Inlet()
        self._waitset = native.WaitSet(self._participant._ref, self._inlet)
        for key, reader in enumerate(self.peers.readers):
            self._waitset.attach(reader._ref, key)
        self._waitset.attach(self._announcer.reader, _ANNOUNCEMENTS)

    # -- endpoints

    def _open(self, kind: Any, topic: str, type_name: str, qos: Qos, *receiver: Any) -> Any:
        with self._lock:
            full, name = self._resolve(topic, type_name)
            # First: a client on Fast DDS must not see the others alone (service.py).
            decoy = self.decoy(full, name) if kind is DdsServer else None
            try:
                endpoint = kind(*receiver, *self._make(full, name, qos, kind))
            except BaseException:
                if decoy is not None:
                    native.delete(decoy)
                raise
            if decoy is not None:
                endpoint.decoy = decoy
            self._adopt(endpoint)
        self._waitset.wake()
        return endpoint

    def _entity(self, kind: Any, topic: str, data_type: Any, qos: DdsQos, group: Any = None) -> Any:
        group = group or (self._subscribers if kind is DataReader else self._publishers)
        return kind(group, self._topics(topic, data_type), qos)

    def _make(self, full: str, name: str, qos: Qos, kind: Any) -> tuple[Any, ...]:
        """Open all entities of an endpoint (one or two), or none; return its arguments."""
        reads, service_id = kind.direction == "in", ""
        parts: tuple[str, ...] = (name,)
        topics: tuple[str, ...] = (dds_topic(full),)
        settings, type_of = qos, self._types.__getitem__
        if kind.serves:
            # As rmw_cyclonedds_cpp writes it: not padded, but for the first byte.
            first, *others = self._guid[:12] + next(self._service_ids).to_bytes(4, "big")
            role = "serviceid" if reads else "clientid"
            service_id = f"{role}={first:2x}{''.join(f'.{octet:x}' for octet in others)};"
            parts, topics = (f"{name}_Request", f"{name}_Response"), service_topics(full)
            settings, type_of = _base.queue_of(qos), self._types.with_header
        kinds = (DataReader, DataWriter) if reads else (DataWriter, DataReader)
        hashes = [*map(self._hash, parts)]
        opened: list[Any] = []
        try:
            for each, topic, part, type_hash in zip(kinds, topics, parts, hashes, strict=False):
                how = dds_qos(settings, type_hash, service_id)
                opened.append(self._entity(each, topic, type_of(part), how))
        except DDSException as error:
            for entity in opened:
                native.delete(entity)
            raise native.refusal(f"cannot open {full} as {name}", error) from error
        if kind.serves:  # reader and writer, whatever comes first
            opened = [*(opened if reads else reversed(opened)), hashes[1]]
        return *opened, self, full, name, qos, hashes[0]

    def _hash(self, name: str) -> str:
        return super()._hash(name) if self._hashes else ""

    def decoy(self, service: str, type_name: str) -> Any:
        """Open another writer for a service's responses, which matches no reader."""
        topic, data_type = service_topics(service)[1], self._types.with_header(f"{type_name}_Response")
        try:
            return self._entity(DataWriter, topic, data_type, dds_qos(Qos(depth=1), ""), self._decoys)
        except DDSException as error:
            raise native.refusal(f"cannot open {service} as {type_name}", error) from error

    def _adopt(self, endpoint: Endpoint) -> None:
        self._endpoints.append(endpoint)
        self._changed = True
        self._suspects.setdefault(endpoint.dds_topic, self.clock.monotonic_ns())
        endpoint.review()
        if not isinstance(endpoint, DdsPublisher):
            # Not soon again that of one that was closed, whose messages may be on their way here.
            endpoint.key = next(key for key in self._keys if key not in self._readers)
            self._readers[endpoint.key] = endpoint
            endpoint.condition = self._waitset.attach(endpoint.reader_ref, endpoint.key)

    def route(self, subscription: DdsSubscription) -> bool:
        """Route messages to a subscription's sink if none are from strangers; return whether it is routed."""
        with self._lock:
            if self._inlet is None or not subscription.condition or subscription.closed:
                return False
            if (sink := subscription.sink) is not None and not subscription.strangers:
                self._inlet.add(subscription.key, subscription.reader_ref, sink.capsule)
            else:
                self._inlet.remove(subscription.key)
            return True

    def forget(self, endpoint: Endpoint) -> None:
        """Note that an endpoint is being closed."""
        with self._lock:
            super().forget(endpoint)
            if endpoint.condition:
                self._readers = {key: one for key, one in self._readers.items() if one is not endpoint}
                self._waitset.detach(endpoint.condition)
                if self._inlet is not None:
                    self._inlet.remove(endpoint.key)
            for pair in [pair for pair in self._since if pair[0] == endpoint.guid]:  # type: ignore[index]
                del self._since[pair]
            self._changed = True
        self._waitset.wake()

    def writer(self, topic: str, handle: int) -> Peer | None:
        """Return the writer of a message; called by the receive thread."""
        if (found := self.peers.find(topic, "out", handle)) is None:
            self._look(0)
            found = self.peers.find(topic, "out", handle)
        return found

    def hurry(self, server: DdsServer) -> None:
        """Check a server's responses soon."""
        self._hurried.append(server)
        self._waitset.wake()

    # -- receiving

    def _run(self) -> None:
        wait = self._waitset.wait
        next_tick = 0
        while not self._closed:
            try:
                keys, left = wait(_SHORT_NS if self._hurried else _TICK_NS)
                for key in sorted(keys):  # peers before messages
                    if key >= _FIRST:
                        if (endpoint := self._readers.get(key)) is not None:
                            endpoint.take()
                    elif key == _ANNOUNCEMENTS:
                        self._announcer.take()
                    elif key == _PARTICIPANTS:
                        for participant in self.peers.gone():
                            self._announcer.forget(participant)
                    else:
                        self._look(key)
                for key, payload, stamp_ns in left:
                    if isinstance(receiver := self._readers.get(key), DdsSubscription):
                        receiver.deliver(payload, stamp_ns)
                if self.peers.left:
                    self._part()
                for _ in range(len(self._hurried)):
                    if (server := self._hurried.popleft()).flush():
                        self._hurried.append(server)
                if self._changed:
                    self._changed = False
                    with self._lock:
                        guids = [pair for one in self._endpoints for pair in one.guids.items()]
                    self._announcer.announce(dict(guids))
                if (now := self.clock.monotonic_ns()) >= next_tick:
                    next_tick = now + _TICK_NS
                    library_log.drain()
                    self._tick(now)
            except Exception:  # a defect; but the other topics have to go on
                self.logger.exception("error in the receive thread of %s", self.node)
                self.clock.sleep(100_000_000)

    def _look(self, which: int) -> None:
        with self._lock:
            self._review(self.peers.update(which))

    def _part(self) -> None:
        """Forget the endpoints that are gone, after their earlier responses have been taken."""
        left = frozenset(self.peers.left)
        clients = [endpoint for endpoint in self.endpoints() if isinstance(endpoint, DdsClient)]
        for client in clients:
            client.take()
        with self._lock:
            changed = self.peers.forget(left)
            self._review(changed)
        for client in clients:
            if client.dds_topic in changed:
                client.end_orphans([peer.handle for peer in self.peers.on(client.dds_topic, "in")])

    def _review(self, changed: set[str]) -> None:
        self._suspects |= dict.fromkeys(changed, self.clock.monotonic_ns())
        self._reviewed |= changed
        for endpoint in self._readers.values():
            if endpoint.dds_topic in changed:
                endpoint.review()

    # -- what is wrong

    def changed(self) -> set[Endpoint]:
        """Return the endpoints whose state may have changed since this was last called."""
        with self._lock:
            reviewed, self._reviewed = self._reviewed, set()
            endpoints, pairs = self._watched
            if endpoints != (present := tuple(self._endpoints)):
                endpoints, pairs = present, sum((one.changing for one in present), array("i"))
                self._watched = endpoints, pairs
            news = {endpoints[place] for place in changed(pairs)}
            for endpoint in news:
                endpoint.dirty = True
            if reviewed:
                news.update(one for one in endpoints if one.dds_topic in reviewed)
            return news

    def _tick(self, now: int) -> None:
        with self._lock:
            due = {topic for topic, since in self._suspects.items() if now - since >= _base.SETTLE_NS}
            self._suspects = {topic: since for topic, since in self._suspects.items() if topic not in due}
            endpoints = [endpoint for endpoint in self._endpoints if endpoint.dds_topic in due]
            self._reviewed |= due
        for endpoint in endpoints:
            self._warn(endpoint)

    def _judge(self, endpoint: Endpoint) -> tuple[bool, list[Problem | None]]:
        peers = self.peers.on(endpoint.dds_topic, "out" if endpoint.direction == "in" else "in")
        matched = endpoint.matched_handles()
        problems = [self._explain(endpoint, peer, peer.handle in matched) for peer in peers]
        return bool(peers or matched), problems

    def _other_servers(self, endpoint: Endpoint) -> list[str]:
        servers = self.peers.on(endpoint.dds_topic, "in")
        return [self._name(peer) for peer in servers if peer.guid != endpoint.guid]

    def _name(self, peer: Peer) -> str:
        own = self.node if peer.guid[:12] == self._guid[:12] else ""
        node = own or self._announcer.node_of(peer.guid)
        return f"node {node}" if node else f"a DDS participant without a ROS node ({peer.guid[:12].hex()})"

    def _explain(self, endpoint: Endpoint, peer: Peer, matched: bool) -> Problem | None:
        """Return a peer's problem, or None."""
        # If one does not match that should by all that is announced, the definitions differ; but discovery
        # and matching lag a moment behind each other when a peer comes or goes: reported only once it has
        # lasted.
        name = self._name(peer)
        if endpoint.serves and not peer.has_header:
            does = _base.describe(peer.info, name)
            return "ROS021", f"{does} {_FOREIGN}"
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
        """Return the graph of the other nodes."""

        def infos(start: str) -> Iterator[EndpointInfo]:
            for peer in self.peers.all():
                if peer.dds_topic.startswith(start) and peer.guid[:12] != self._guid[:12]:
                    foreign = start == "rq/" and not peer.has_header
                    obstacles = (*peer.info.obstacles, *([_FOREIGN] if foreign else []))
                    node = self._announcer.node_of(peer.guid)
                    yield replace(peer.info, node=node, obstacles=obstacles)

        return _base.graph_info(self._announcer.nodes(), infos("rt/"), infos("rq/"))

    def _stop(self) -> None:
        self._waitset.wake()
        self._join()

    def _leave(self) -> None:
        self._announcer.close()
        self._waitset.close()
        self._topics.close()
        groups = (self._publishers, self._decoys, self._subscribers, self._participant)
        for entity in (*self.peers.readers, *groups):
            native.delete(entity)
        leave(self.domain)


# Connect to a ROS 2 graph; arguments and errors as for `rosplc.ros.open_backend`; no options.
open_backend = _base.opener(DdsBackend)
