"""Liveliness tokens: how nodes and endpoints on Zenoh show themselves to each other.

A token is a key: ``@ros2_lv/domain/session/node/entity/kind/enclave/namespace/name``, and for an
endpoint ``/topic/type/hash/qos`` behind it. Zenoh tells everybody when one appears, and when its
session is gone. What others write is not trusted: a token that ROS could not have written is
refused here.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import Literal

import xxhash

from rosplc.errors import BackendError
from rosplc.ros.names import join, validate_namespace, validate_node_name, validate_topic
from rosplc.ros.qos import Qos
from rosplc.ros.zenoh.keys import (
    NO_TYPE_HASH,
    dds_type_name,
    decode_qos,
    demangle,
    encode_qos,
    mangle,
    ros_type_name,
)

__all__ = ["LONGEST_TOKEN", "Entity", "Kind", "gid_of", "parse_token", "tokens_of_domain"]

_SPACE = "@ros2_lv"
_NODE_PARTS, _ENDPOINT_PARTS = 9, 13  # later releases may append more
LONGEST_TOKEN = 2048
"""Characters of a token; ROS' own names leave it far below."""

_TYPE = re.compile(r"[A-Za-z0-9_:/]{1,255}\Z")
_HASH = re.compile(r"[A-Za-z0-9_]{1,128}\Z")
_ID = re.compile(r"[A-Za-z0-9_.\-]{1,64}\Z")

Kind = Literal["NN", "MP", "MS"]
"""A node, a publisher, a subscription."""


@dataclass(frozen=True, slots=True)
class Entity:
    """What one token says.

    Attributes:
        domain: The ROS domain.
        session: The id of the Zenoh session.
        node_id: Number of the node in its session.
        entity_id: Number of the entity in its session; a node's own number if it is a node.
        kind: What it is.
        namespace: The node's namespace.
        node: The node's base name.
        topic: The absolute topic name; empty for a node.
        type_name: The ROS type name; empty for a node.
        type_hash: The type hash as the key has it (:data:`~rosplc.ros.zenoh.keys.NO_TYPE_HASH` on Humble).
        qos: The settings; None for a node.
    """

    domain: int
    session: str
    node_id: str
    entity_id: str
    kind: Kind
    namespace: str
    node: str
    topic: str = ""
    type_name: str = ""
    type_hash: str = NO_TYPE_HASH
    qos: Qos | None = None

    @property
    def full_name(self) -> str:
        """The node's full name."""
        return join(self.namespace, self.node)

    @property
    def token(self) -> str:
        """The key of its token, as ``rmw_zenoh_cpp`` writes it."""
        enclave = mangle("/")
        parts = [_SPACE, str(self.domain), self.session, self.node_id, self.entity_id, self.kind]
        parts += [enclave, mangle(self.namespace), self.node]
        if self.qos is not None:
            parts += [mangle(self.topic), dds_type_name(self.type_name), self.type_hash, encode_qos(self.qos)]
        return "/".join(parts)


def tokens_of_domain(domain: int) -> str:
    """Return the key expression of all tokens in a domain."""
    return f"{_SPACE}/{domain}/**"


def gid_of(token: str) -> bytes:
    """Return an entity's 16-byte id: the XXH3 hash of its token, the low word first."""
    return int(xxhash.xxh3_128_intdigest(token.encode())).to_bytes(16, "little")


def parse_token(token: str) -> Entity | None:
    """Read a token; None for the kinds that are no part of topics (services, clients).

    Raises:
        ValueError: It is not what a ROS node announces.
    """
    if len(token) > LONGEST_TOKEN:
        raise ValueError(f"it has {len(token)} characters")
    parts = token.split("/")
    if len(parts) < _NODE_PARTS or parts[0] != _SPACE:
        raise ValueError(f"it has {len(parts)} parts")
    domain, session, node_id, entity_id, kind, _enclave, namespace, node = parts[1:_NODE_PARTS]
    if kind in ("SS", "SC"):
        return None
    if not domain.isascii() or not domain.isdigit() or len(domain) > 10:
        raise ValueError("its domain is no number")
    if not all(map(_ID.match, (session, node_id, entity_id))):
        raise ValueError("one of its ids is none")
    try:
        # Written by releases that leave the root namespace without its slash.
        validate_namespace(namespace := demangle(namespace) or "/")
        validate_node_name(node := demangle(node))
        if kind == "NN":
            return Entity(int(domain), session, node_id, entity_id, "NN", namespace, node)
        if kind not in ("MP", "MS"):
            raise ValueError("it is of no known kind")
        if len(parts) < _ENDPOINT_PARTS:
            raise ValueError("it names no topic")
        topic, type_name, type_hash, qos = parts[_NODE_PARTS:_ENDPOINT_PARTS]
        validate_topic(topic := demangle(topic))
    except BackendError as error:
        raise ValueError(error.what) from error
    if not _TYPE.match(type_name := demangle(type_name)) or not _HASH.match(type_hash):
        raise ValueError("its type or type hash is none")
    return Entity(
        int(domain),
        session,
        node_id,
        entity_id,
        "MP" if kind == "MP" else "MS",
        namespace,
        node,
        topic,
        ros_type_name(type_name),
        type_hash,
        decode_qos(qos),
    )
