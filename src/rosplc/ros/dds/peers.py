"""The other participants' endpoints, from DDS's builtin topics and the library's own structures.

DDS does not report why a reader and a writer of one topic do not match, so the reason is found by comparison:
another type name, another type hash (ROS announces it in the endpoint's user data), incompatible settings,
or, if none of these, another definition of the type.

The wheel has a function that reads settings, but stores the results in class variables: if two threads
use it at the same time, they mix up the settings of two peers.
"""

from __future__ import annotations

import ctypes as ct
import logging
import re
import threading
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any

from cyclonedds._clayer import ddspy_take, ddspy_take_endpoint, ddspy_take_participant, ddspy_write
from cyclonedds.builtin import (
    BuiltinDataReader,
    BuiltinTopicDcpsParticipant,
    BuiltinTopicDcpsPublication,
    BuiltinTopicDcpsSubscription,
)
from cyclonedds.core import InstanceState
from cyclonedds.pub import DataWriter
from cyclonedds.sub import DataReader

from rosplc.errors import BackendError
from rosplc.harmless import one_line
from rosplc.model import ArrayType, TypeStore
from rosplc.ros import fields
from rosplc.ros._base import is_cdr
from rosplc.ros.backend import EndpointInfo, Qos
from rosplc.ros.dds import native
from rosplc.ros.dds.idl import IdlTypes, ros_service, ros_topic
from rosplc.ros.names import ros_type_name, service_type_name

_TYPE_HASH = re.compile(rb"(?:^|;)typehash=(RIHS01_[0-9a-f]{64});")
_SERVICE_ID = re.compile(rb"(?:^|;)(?:client|service)id=([^;]*);")
_CYCLONE = b"\x01\x10"  # The vendor, with which ids begin.
_BATCH = 256
_INFINITE = 2**63 - 1
# Numbers of the library's enumerations.
_XCDR1 = 0
_VOLATILE, _TRANSIENT_LOCAL = 0, 1
_RELIABLE = _EXCLUSIVE = 1
_AUTOMATIC = 0


@dataclass(frozen=True, slots=True)
class Peer:
    """An endpoint of another participant."""

    guid: bytes
    handle: int  # its instance handle, by which DDS lists matched peers
    dds_topic: str
    info: EndpointInfo  # in ROS's words, without its node; the topic is DDS's if it is none of ROS
    service_id: str = ""  # by which the two endpoints of a service's client or server belong together

    @property
    def has_header(self) -> bool:
        """Whether its calls have their header in the payload, as in ``rmw_cyclonedds_cpp``."""
        return bool(self.service_id) or self.guid[:2] == _CYCLONE


class PeerTable:
    """The endpoints discovered so far; updated by the receive thread."""

    def __init__(self, participant: Any, own: bytes) -> None:
        # Our 16-byte id: our endpoints are left out, but those of services, since a node may call itself.
        self._own = own
        self._lock = threading.Lock()
        self._peers: dict[bytes, Peer] = {}
        self._by_topic: dict[tuple[str, str], tuple[Peer, ...]] = {}
        self.left: set[bytes] = set()  # ids of endpoints that have gone; they are kept until :meth:`forget`
        self.readers = (
            BuiltinDataReader(participant, BuiltinTopicDcpsPublication),
            BuiltinDataReader(participant, BuiltinTopicDcpsSubscription),
            BuiltinDataReader(participant, BuiltinTopicDcpsParticipant),
        )

    def update(self, which: int) -> set[str]:
        """Take new data from ``readers[which]``, 0 or 1; return the DDS topics with new endpoints."""
        direction = "out" if which == 0 else "in"
        changed: set[str] = set()

        def see(guid: bytes, participant: bytes, *shown: Any) -> None:
            _, topic, kind, said, info, _ = shown
            (self.left.add if _gone(info) else self.left.discard)(guid)
            if guid not in self.left and topic is not None and kind is not None and said is not None:
                name, type_name = ros_topic(topic) or topic, ros_type_name(kind)
                if service := ros_service(topic):
                    name, type_name = service, service_type_name(kind)
                elif participant == self._own:
                    return
                *settings, service_id = said
                endpoint = EndpointInfo(name, type_name, direction, "", *settings)  # type: ignore[arg-type]
                peer = Peer(guid, info.instance_handle, topic, endpoint, service_id)
                with self._lock:
                    others = self._others(topic, direction, guid)
                    self._peers[guid], self._by_topic[topic, direction] = peer, (*others, peer)
                changed.add(topic)

        ref = self.readers[which]._ref
        while True:
            taken = ddspy_take_endpoint(ref, _BATCH, see, lambda pointer: _announced(pointer, which == 0))
            if isinstance(taken, int) or len(taken) < _BATCH:
                return changed

    def gone(self) -> set[bytes]:
        """Take new data from ``readers[2]``; return the ids of participants that have left or died."""
        left: set[bytes] = set()

        def see(guid: bytes, _: None, info: Any) -> None:
            if _gone(info):
                left.add(guid)

        while True:
            taken = ddspy_take_participant(self.readers[2]._ref, _BATCH, see, lambda _: None)
            if isinstance(taken, int) or len(taken) < _BATCH:
                return left

    def forget(self, guids: Iterable[bytes]) -> set[str]:
        """Forget endpoints that are gone; return the DDS topics concerned."""
        self.left.difference_update(guids)
        with self._lock:
            known = [self._peers.pop(guid) for guid in guids if guid in self._peers]
            for peer in known:
                key = peer.dds_topic, peer.info.direction
                if others := self._others(*key, peer.guid):
                    self._by_topic[key] = others
                else:  # topics that come and go under new names fill no memory
                    del self._by_topic[key]
        return {peer.dds_topic for peer in known}

    def _others(self, topic: str, direction: str, guid: bytes) -> tuple[Peer, ...]:
        return tuple(peer for peer in self.on(topic, direction) if peer.guid != guid)

    def on(self, topic: str, direction: str) -> tuple[Peer, ...]:
        """Return the endpoints of one direction on a DDS topic; the same object while they are unchanged."""
        return self._by_topic.get((topic, direction), ())

    def find(self, topic: str, direction: str, handle: int) -> Peer | None:
        """Return the endpoint with this handle on a DDS topic."""
        return next((peer for peer in self.on(topic, direction) if peer.handle == handle), None)

    def all(self) -> tuple[Peer, ...]:
        """Return all endpoints."""
        with self._lock:
            return tuple(self._peers.values())


def _gone(info: Any) -> bool:
    return not info.valid_data or info.instance_state != InstanceState.Alive


def type_hash_in(user_data: bytes) -> str:
    """Return the ROS type hash in an endpoint's user data; empty if there is none."""
    found = _TYPE_HASH.search(user_data)
    return found.group(1).decode() if found else ""


# -- a dds_qos_t of the library


def _getter(name: str, *kinds: Any, default: tuple[Any, ...]) -> Any:
    """Return a function that reads the values of one setting; ``default`` if it is not set."""
    call = native.function(f"dds_qget_{name}", ct.c_void_p, *map(ct.POINTER, kinds), result=ct.c_bool)

    def get(qos: int) -> tuple[Any, ...]:
        values = [kind() for kind in kinds]
        known = call(qos, *map(ct.byref, values))
        return tuple(getattr(value, "value", value) for value in values) if known else default

    return get


_free = native.function("dds_free", ct.c_void_p, result=None)
_reliability = _getter("reliability", ct.c_int, ct.c_int64, default=(None, 0))
_durability = _getter("durability", ct.c_int, default=(_VOLATILE,))
_deadline = _getter("deadline", ct.c_int64, default=(_INFINITE,))
_liveliness = _getter("liveliness", ct.c_int, ct.c_int64, default=(_AUTOMATIC, _INFINITE))
_ownership = _getter("ownership", ct.c_int, default=(None,))
_partition = _getter("partition", ct.c_uint32, ct.POINTER(ct.c_void_p), default=(0, None))
_representation = _getter("data_representation", ct.c_uint32, ct.POINTER(ct.c_int16), default=(0, None))
_userdata = _getter("userdata", ct.c_void_p, ct.c_size_t, default=(None, 0))


def _announced(pointer: int, writer: bool) -> tuple[Qos, str, tuple[str, ...], str]:
    """Return settings, type hash, other obstacles to matching a plain ROS endpoint, and a service's id."""
    reliability, _ = _reliability(pointer)
    # Best effort is DDS's default of readers, reliable that of writers.
    reliable = writer if reliability is None else reliability == _RELIABLE
    qos = Qos(
        "reliable" if reliable else "best_effort",
        "volatile" if _durability(pointer)[0] == _VOLATILE else "transient_local",
        1,
        deadline_ns=_time(_deadline(pointer)[0]),
        lease_ns=_time(_liveliness(pointer)[1]),
    )
    user_data = _user_data(pointer)
    service_id = found.group(1).decode(errors="replace") if (found := _SERVICE_ID.search(user_data)) else ""
    return qos, type_hash_in(user_data), tuple(_obstacles(pointer, writer)), service_id


def _time(ns: int) -> int:
    """Return a time in the form of :class:`Qos`: 0 means none."""
    return 0 if ns >= _INFINITE else max(1, ns)


def _user_data(pointer: int) -> bytes:
    address, size = _userdata(pointer)
    found = ct.string_at(address, size) if address else b""
    _free(address)
    return found


def _items(count: int, array: Any) -> list[Any]:
    """Return an array that the library has allocated, and free it."""
    found = array[:count] if count else []
    _free(array)
    return found


def _partitions(pointer: int) -> list[str]:
    names = _items(*_partition(pointer))
    found = [ct.string_at(name).decode(errors="replace") for name in names]
    for name in names:
        _free(name)
    return found


def _obstacles(pointer: int, writer: bool) -> Iterator[str]:
    representations = _items(*_representation(pointer))
    # A writer uses the first that it names; a reader takes any that it names.
    if representations and _XCDR1 not in (representations[:1] if writer else representations):
        yield "it does not use XCDR version 1, the data representation of ROS"
    partitions = _partitions(pointer)
    if partitions and "" not in partitions and "*" not in partitions:
        yield f"it is in the DDS partition {', '.join(partitions)}"
    if _ownership(pointer)[0] == _EXCLUSIVE:
        yield "it has exclusive ownership"
    if not writer and _durability(pointer)[0] > _TRANSIENT_LOCAL:
        yield "it requests transient or persistent durability, which ROS does not support"
    if not writer and _liveliness(pointer)[0] != _AUTOMATIC:
        yield "it requests manual liveliness"


_logger = logging.getLogger("rosplc.ros.dds")

ANNOUNCEMENT_TOPIC = "ros_discovery_info"
ANNOUNCEMENT = "rmw_dds_common/msg/ParticipantEntitiesInfo"

LONGEST_NAME = 256  # the bound in rmw_dds_common/msg/NodeEntitiesInfo


@dataclass(frozen=True, slots=True)
class NodeEntities:
    """A node of a participant: its names, and the 16-byte ids of its DDS readers and writers."""

    namespace: str
    name: str
    readers: tuple[bytes, ...] = ()
    writers: tuple[bytes, ...] = ()

    @property
    def full_name(self) -> str:
        """``/robot1/talker``."""
        return one_line(f"/{self.namespace.strip('/')}/{self.name}".replace("//", "/"))


def encode_announcement(types: TypeStore, participant: bytes, nodes: Iterable[NodeEntities]) -> bytes:
    """Return the CDR bytes of a participant's announcement; ``types`` are those of a distribution."""
    (data,) = types["rmw_dds_common/msg/Gid"].fields
    assert isinstance(data.type, ArrayType)
    size = data.type.length

    def gid(guid: bytes) -> dict[str, bytes]:
        return {"data": guid.ljust(size, b"\0")}

    listed = [
        {
            "node_namespace": node.namespace,
            "node_name": node.name,
            "reader_gid_seq": [*map(gid, node.readers)],
            "writer_gid_seq": [*map(gid, node.writers)],
        }
        for node in nodes
    ]
    values = {"gid": gid(participant), "node_entities_info_seq": listed}
    encoded = fields.pack(types, ANNOUNCEMENT, values)
    return encoded + bytes(-len(encoded) % 4)


def decode_announcement(types: TypeStore, data: bytes) -> tuple[bytes, tuple[NodeEntities, ...]]:
    """Return the participant's 16-byte id and its nodes; ROS008 if the bytes are not an announcement."""
    if not is_cdr(data):
        raise BackendError("ROS008", "the announcement is not plain CDR")
    found = fields.unpack(types, ANNOUNCEMENT, data)

    def ids(*gids: dict[str, bytes]) -> tuple[bytes, ...]:
        return tuple(gid["data"][:16] for gid in gids)

    nodes = []
    for node in found["node_entities_info_seq"]:
        names = node["node_namespace"], node["node_name"]
        if any(len(name.encode(errors="surrogateescape")) > LONGEST_NAME for name in names):
            raise BackendError("ROS008", "a name is too long")
        nodes.append(NodeEntities(*names, ids(*node["reader_gid_seq"]), ids(*node["writer_gid_seq"])))
    return ids(found["gid"])[0], tuple(nodes)


_QOS = Qos(durability="transient_local", depth=1)
MOST_PARTICIPANTS = 10_000  # anybody may announce in the name of participants that there are not
_READ_QOS = Qos(durability="transient_local", depth=1000)  # one instance for all participants: no keys


class Announcer:
    """Announces a node to the graph; ``qos_of`` makes the wheel's QoS from a :class:`Qos` and a type hash.

    DDS has participants but no nodes: every ROS 2 process announces on ``ros_discovery_info`` which of its
    endpoints belong to which node. The bytes are handled here because the wheel's classes use a Python object
    per byte of a gid, which would delay the receive thread.
    """

    def __init__(
        self,
        participant: Any,
        topics: Callable[[str, Any], Any],
        guid: bytes,
        namespace: str,
        name: str,
        store: TypeStore,
        qos_of: Callable[[Qos, str], Any],
    ) -> None:
        self._guid = guid  # 16 bytes
        self._node = (namespace, name)
        self._lock = threading.RLock()
        self._others: dict[bytes, tuple[NodeEntities, ...]] = {}
        self._names: dict[bytes, str] = {}
        # A store of custom types need not have the announcement's.
        self._types = store if ANNOUNCEMENT in store.names() else TypeStore.bundled("jazzy")
        type_hash = "" if store.distro == "humble" else self._types.type_hash(ANNOUNCEMENT)
        topic = topics(ANNOUNCEMENT_TOPIC, IdlTypes(self._types)[ANNOUNCEMENT])
        self._writer = DataWriter(participant, topic, qos_of(_QOS, type_hash))
        self._reader = DataReader(participant, topic, qos_of(_READ_QOS, type_hash))
        self.reader: int = self._reader._ref
        self.announce({})

    def announce(self, endpoints: Mapping[bytes, bool], *, leaving: bool = False) -> None:
        """Publish the node's endpoints (id → whether it is a reader), or that the node is gone."""
        readers, writers = (
            tuple(sorted(guid for guid, reads in endpoints.items() if reads is wanted))
            for wanted in (True, False)
        )
        nodes = () if leaving else (NodeEntities(*self._node, readers, writers),)
        code = ddspy_write(self._writer._ref, encode_announcement(self._types, self._guid, nodes))
        if code < 0:
            _logger.warning("cannot announce the node: %s", native.refusal("write", code))

    def take(self) -> None:
        """Read the other participants' announcements."""
        samples = ddspy_take(self.reader, native.ANY_STATE, 1024)
        if isinstance(samples, int):
            return
        for data, info in samples:
            if not info.valid_data:
                continue
            try:
                guid, nodes = decode_announcement(self._types, data)
            except BackendError as error:
                _logger.warning("cannot read an announcement on %s: %s", ANNOUNCEMENT_TOPIC, error)
                continue
            if guid == self._guid:
                continue
            with self._lock:
                self.forget(guid)
                if len(self._others) >= MOST_PARTICIPANTS:
                    continue
                self._others[guid] = nodes
                for node in nodes:
                    for gid in node.readers + node.writers:
                        self._names[gid] = node.full_name

    def forget(self, participant: bytes) -> None:
        """Remove the announcement of a participant that is gone or has a new announcement."""
        with self._lock:
            for node in self._others.pop(participant, ()):
                for gid in node.readers + node.writers:
                    self._names.pop(gid, None)

    def node_of(self, endpoint: bytes) -> str:
        """Return the full name of the node that an endpoint belongs to; empty if unknown."""
        with self._lock:
            return self._names.get(endpoint, "")

    def nodes(self) -> tuple[str, ...]:
        """Return the full names of the other nodes, sorted."""
        with self._lock:
            return tuple(sorted({node.full_name for nodes in self._others.values() for node in nodes}))

    def close(self) -> None:
        """Announce that the node is gone, and delete the entities."""
        self.announce({}, leaving=True)
        for entity in (self._writer, self._reader):
            native.delete(entity)
