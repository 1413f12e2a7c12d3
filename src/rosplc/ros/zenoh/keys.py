"""The keys, liveliness tokens and attachments of ``rmw_zenoh_cpp``: design.md, liveliness_utils.

A token is a key: ``@ros2_lv/domain/session/node/entity/kind/enclave/namespace/name``, followed for an
endpoint by ``/topic/type/hash/qos``. Zenoh reports to all nodes when a token appears, and when its session
is gone. Other nodes' tokens are not trusted: a token that ROS could not have written is refused here.

Quality of service is ``reliability:durability:history,depth:deadline:lifespan:liveliness``, where the last
three are ``seconds,nanoseconds`` (liveliness: ``kind,seconds,nanoseconds``). Numbers are those of
``rmw/types.h``; rmw_zenoh's defaults are left empty. Early releases wrote only the first three parts, with
every number.

An attachment has 33 bytes in Zenoh's serialization format: ``int64`` sequence, ``int64`` nanoseconds since
1970, the length 16, and 16 bytes of id, all little-endian.
"""

from __future__ import annotations

import logging
import re
import struct
import threading
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any, Literal, NamedTuple

import xxhash

from rosplc.errors import BackendError
from rosplc.ros import _base, names
from rosplc.ros.backend import Durability, EndpointInfo, GraphInfo, Qos, Reliability

NO_TYPE_HASH = "TypeHashNotSupported"  # Stands for the type hash on Humble, which has none.
LONGEST_TOKEN = 2048  # Characters of a token; ROS' own names leave it far below.
MOST_TOKENS = 65_536  # Nodes and endpoints that are kept in mind; far above any real graph.

Kind = Literal["NN", "MP", "MS", "SC", "SS"]  # A node, a publisher, a subscription, a client, a server.
# What each exchanges messages with.
OTHER: dict[Kind, Kind] = {"MP": "MS", "MS": "MP", "SC": "SS", "SS": "SC"}

_TYPE = re.compile(r"[A-Za-z0-9_:/]{1,255}\Z")
_HASH = re.compile(r"[A-Za-z0-9_]{1,128}\Z")
_ID = re.compile(r"[A-Za-z0-9_.\-]{1,64}\Z")
SPACE = "@ros2_lv"  # Of the tokens, before the domain.
_NODE_PARTS, _ENDPOINT_PARTS = 9, 13  # later releases may append more


def topic_key(domain: int, topic: str, type_name: str, type_hash: str) -> str:
    """Return the key for a topic's messages or a service's requests."""
    return f"{domain}/{topic.strip('/')}/{names.dds_type_name(type_name)}/{type_hash}"


# -- quality of service

_BEST_EFFORT = "2"
_TRANSIENT_LOCAL = "1"
_KINDS = frozenset({"", "0", "1", "2", "3", "4", "5"})  # of rmw's enumerations; empty is the default
_DEPTH = 42  # rmw_zenoh's default, which is not ROS's
_LONGEST = 2**31 - 1
_UNBOUNDED = ":,:,:,,"  # no deadline, no lifespan, automatic liveliness without a lease


def encode_qos(qos: Qos) -> str:
    """Return the settings in the form used in a token."""
    reliability = "" if qos.reliability == "reliable" else _BEST_EFFORT
    durability = "" if qos.durability == "volatile" else _TRANSIENT_LOCAL
    depth = "" if qos.depth == _DEPTH else qos.depth
    return f"{reliability}:{durability}:,{depth}{_UNBOUNDED}"


def decode_qos(text: str) -> Qos:
    """Read the settings of a token, in the short or long form; ValueError if it is neither."""
    parts = text.split(":")
    if len(parts) < 3:
        raise ValueError("the QoS has fewer than three parts")
    history, comma, depth = parts[2].partition(",")
    if not comma or not {parts[0], parts[1], history} <= _KINDS:
        raise ValueError("the QoS has values that ROS does not define")
    numbers = [depth, *(number for part in parts[3:6] for number in part.split(","))]
    if not all(number == "" or (number.isascii() and number.isdigit()) for number in numbers):
        raise ValueError("the QoS has parts that are not numbers")
    reliability: Reliability = "best_effort" if parts[0] == _BEST_EFFORT else "reliable"
    durability: Durability = "transient_local" if parts[1] == _TRANSIENT_LOCAL else "volatile"
    return Qos(reliability, durability, max(1, min(int(depth[:20] or _DEPTH), _LONGEST)))


# -- attachments

_GID_SIZE = 16
_FORMAT = struct.Struct(f"<qqB{_GID_SIZE}s")


class Attachment(NamedTuple):
    """A message's attachment: its number, from 1; the time of sending (ns since 1970); the publisher's id."""

    sequence: int
    stamp_ns: int
    gid: bytes


def pack(sequence: int, stamp_ns: int, gid: bytes) -> bytes:
    """Return the attachment's bytes."""
    return _FORMAT.pack(sequence, stamp_ns, _GID_SIZE, gid)


def unpack(data: bytes) -> Attachment:
    """Read an attachment; ValueError if it is invalid."""
    if len(data) < _FORMAT.size:
        raise ValueError(f"the attachment has {len(data)} bytes, not {_FORMAT.size}")
    sequence, stamp_ns, size, gid = _FORMAT.unpack_from(data)
    if size != _GID_SIZE:
        raise ValueError(f"the sender's id has {size} bytes, not {_GID_SIZE}")
    if sequence < 0 or stamp_ns < 0:
        raise ValueError("the sequence number or the time stamp is negative")
    return Attachment(sequence, stamp_ns, gid)


# -- tokens


@dataclass(frozen=True, slots=True)
class Entity:
    """The content of a token."""

    domain: int
    session: str
    node_id: str  # number of the node in its session
    entity_id: str  # number of the entity in its session; a node's own number if it is a node
    kind: Kind
    namespace: str
    node: str
    topic: str = ""  # the absolute topic name; empty for a node
    type_name: str = ""
    type_hash: str = NO_TYPE_HASH  # as the key has it (:data:`NO_TYPE_HASH` on Humble)
    qos: Qos | None = None  # None for a node

    @property
    def full_name(self) -> str:
        """The node's full name."""
        return names.join(self.namespace, self.node)

    @property
    def info(self) -> EndpointInfo:
        """The endpoint, with an unchanged type hash."""
        direction: Literal["in", "out"] = "out" if self.kind in ("MP", "SC") else "in"
        qos = self.qos or Qos()
        return EndpointInfo(self.topic, self.type_name, direction, self.full_name, qos, self.type_hash)

    @property
    def token(self) -> str:
        """The key of the token, as ``rmw_zenoh_cpp`` writes it."""
        parts = [SPACE, str(self.domain), self.session, self.node_id, self.entity_id, self.kind]
        parts += ["%", self.namespace.replace("/", "%"), self.node]  # % for /: no ROS name has one
        if self.qos is not None:
            kind = names.dds_type_name(self.type_name)
            parts += [self.topic.replace("/", "%"), kind, self.type_hash, encode_qos(self.qos)]
        return "/".join(parts)


def gid_of(token: str) -> bytes:
    """Return an entity's 16-byte id: the XXH3 hash of its token, the low word first."""
    return int(xxhash.xxh3_128_intdigest(token.encode())).to_bytes(16, "little")


def parse_token(token: str) -> Entity:
    """Read a token; ValueError if it is not from a ROS node."""
    if len(token) > LONGEST_TOKEN:
        raise ValueError(f"it has {len(token)} characters; the limit is {LONGEST_TOKEN}")
    parts = [part.replace("%", "/") for part in token.split("/")]
    if len(parts) < _NODE_PARTS or parts[0] != SPACE:
        raise ValueError(f"wrong prefix or number of parts ({len(parts)})")
    domain, session, node_id, entity_id, kind, _enclave, namespace, node = parts[1:_NODE_PARTS]
    if not domain.isascii() or not domain.isdigit() or len(domain) > 10:
        raise ValueError("its domain is not a number")
    if not all(map(_ID.match, (session, node_id, entity_id))):
        raise ValueError("one of its ids is not valid")
    details: tuple[Any, ...] = ()
    try:
        # Written by releases that leave the root namespace without its slash.
        names.validate_namespace(namespace := namespace or "/")
        names.validate_node_name(node)
        if kind != "NN":
            if kind not in OTHER:
                raise ValueError("its kind is unknown")
            if len(parts) < _ENDPOINT_PARTS:
                raise ValueError("it has no topic")
            topic, type_name, type_hash, qos = parts[_NODE_PARTS:_ENDPOINT_PARTS]
            names.validate_topic(topic)
            if not _TYPE.match(type_name) or not _HASH.match(type_hash):
                raise ValueError("its type or type hash is not valid")
            details = (topic, names.ros_type_name(type_name), type_hash, decode_qos(qos))
    except BackendError as error:
        raise ValueError(error.what) from error
    return Entity(int(domain), session, node_id, entity_id, kind, namespace, node, *details)  # type: ignore[arg-type]


# -- the graph


class TokenTable:
    """All live tokens; updated by threads of the library, read by any thread."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._entities: dict[str, Entity] = {}
        self._by_topic: dict[tuple[str, Kind], dict[str, Entity]] = {}
        self.malformed = 0  # tokens that were refused, those beyond :data:`MOST_TOKENS` too

    def appeared(self, token: str) -> str | None:
        """Add a token; return the topic concerned, if any."""
        try:
            entity = parse_token(token)
        except ValueError as error:
            with self._lock:
                self.malformed += 1
                level = logging.WARNING if self.malformed == 1 else logging.DEBUG
            text = "ignoring the announcement %.300r, which is not from a ROS node: %s"
            logging.getLogger("rosplc.ros.zenoh").log(level, text, token, error)
            return None
        with self._lock:
            if len(self._entities) >= MOST_TOKENS and token not in self._entities:
                self.malformed += 1
                return None
            self._entities[token] = entity
            if entity.kind != "NN":
                self._by_topic.setdefault((entity.topic, entity.kind), {})[token] = entity
        return entity.topic or None

    def gone(self, token: str) -> str | None:
        """Remove a token; return the topic concerned, if any."""
        with self._lock:
            entity = self._entities.pop(token, None)
            if entity is None or entity.kind == "NN":
                return None
            others = self._by_topic[entity.topic, entity.kind]
            others.pop(token, None)
            if not others:
                del self._by_topic[entity.topic, entity.kind]
            return entity.topic

    def on(self, topic: str, kind: Kind) -> tuple[Entity, ...]:
        """Return the endpoints of one kind on a topic or service, including our own."""
        with self._lock:
            return tuple(self._by_topic.get((topic, kind), {}).values())

    def gids(self, topic: str, kind: Kind) -> set[bytes]:
        """Return the ids of these endpoints, derived from their tokens."""
        with self._lock:
            return set(map(gid_of, self._by_topic.get((topic, kind), {})))

    def clear(self) -> None:
        """Remove all tokens."""
        with self._lock:
            self._entities.clear()
            self._by_topic.clear()

    def graph(self, own: str) -> GraphInfo:
        """Return the graph without the entities of our own session."""
        with self._lock:
            others = [entity for entity in self._entities.values() if entity.session != own]

        def infos(*kinds: str) -> Iterator[EndpointInfo]:
            for info in (entity.info for entity in others if entity.kind in kinds):
                yield replace(info, type_hash="") if info.type_hash == NO_TYPE_HASH else info

        nodes = (entity.full_name for entity in others if entity.kind == "NN")
        return _base.graph_info(nodes, infos("MP", "MS"), infos("SS", "SC"))


def explain(ours: Entity, theirs: Entity) -> _base.Problem | None:
    """Return a problem or doubt between two endpoints on one topic; None if there is none."""
    # Reliability and durability keep no endpoints apart, as with ``rmw_zenoh_cpp``; but a subscriber may be
    # promised less than it asks for: the code is empty then.
    problem = _base.explain(theirs.info, ours.info)
    if problem is None or problem[0] != "ROS004":
        return problem
    return "", f"{problem[1]}; over Zenoh, messages are exchanged nevertheless"
