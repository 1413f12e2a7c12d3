"""The graph as the liveliness tokens show it, and why an endpoint in it does not match ours.

Over Zenoh a message's key has the topic, the type and its hash: who differs in one of them gets
nothing, silently. Reliability and durability keep nobody apart, as with ``rmw_zenoh_cpp``; but a
subscriber may be promised less than it asks for, and that is worth saying.
"""

from __future__ import annotations

import logging
import threading
from collections.abc import Iterator

from rosplc.ros._base import graph_info
from rosplc.ros.backend import EndpointInfo, GraphInfo, incompatibility
from rosplc.ros.qos import Qos
from rosplc.ros.zenoh.keys import NO_TYPE_HASH
from rosplc.ros.zenoh.tokens import Entity, Kind, parse_token

__all__ = ["MOST_TOKENS", "TokenTable", "explain", "fits"]

MOST_TOKENS = 65_536
"""Nodes and endpoints that are kept in mind; far above any real graph."""

_logger = logging.getLogger("rosplc.ros.zenoh")


class TokenTable:
    """Every token that is alive; updated by threads of the library, read by any.

    Attributes:
        malformed: Tokens that were refused, those beyond :data:`MOST_TOKENS` too.
    """

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._entities: dict[str, Entity] = {}
        self._by_topic: dict[tuple[str, Kind], dict[str, Entity]] = {}
        self.malformed = 0

    def appeared(self, token: str) -> str | None:
        """Take in a token; return the topic concerned, if any."""
        try:
            entity = parse_token(token)
        except ValueError as error:
            self._refuse(token, error)
            return None
        if entity is None:
            return None
        with self._lock:
            if len(self._entities) >= MOST_TOKENS and token not in self._entities:
                self.malformed += 1
                return None
            self._entities[token] = entity
            if entity.kind != "NN":
                self._by_topic.setdefault((entity.topic, entity.kind), {})[token] = entity
        return entity.topic or None

    def _refuse(self, token: str, error: ValueError) -> None:
        with self._lock:
            self.malformed += 1
            first = self.malformed == 1
        text = "a node announces itself with %.300r, which no ROS node would: %s"
        _logger.log(logging.WARNING if first else logging.DEBUG, text, token, error)

    def gone(self, token: str) -> str | None:
        """Drop a token; return the topic concerned, if any."""
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
        """Return the publishers (``MP``) or subscriptions (``MS``) of a topic, our own among them."""
        with self._lock:
            return tuple(self._by_topic.get((topic, kind), {}).values())

    def clear(self) -> None:
        """Forget everything."""
        with self._lock:
            self._entities.clear()
            self._by_topic.clear()

    def graph(self, own: str) -> GraphInfo:
        """Return the graph without the entities of one session, our own."""
        with self._lock:
            others = [entity for entity in self._entities.values() if entity.session != own]
        return graph_info((entity.full_name for entity in others if entity.kind == "NN"), _infos(others))


def _infos(entities: list[Entity]) -> Iterator[EndpointInfo]:
    for entity in entities:
        if entity.qos is not None:
            type_hash = "" if entity.type_hash == NO_TYPE_HASH else entity.type_hash
            yield EndpointInfo(
                entity.topic,
                entity.type_name,
                "out" if entity.kind == "MP" else "in",
                entity.full_name,
                entity.qos,
                type_hash,
            )


def fits(ours: Entity, theirs: Entity) -> bool:
    """Return whether two endpoints on one topic exchange messages."""
    return (theirs.type_name, theirs.type_hash) == (ours.type_name, ours.type_hash)


def explain(ours: Entity, theirs: Entity) -> tuple[str, str] | None:
    """Return code and words for what is wrong or doubtful between two endpoints on one topic.

    The code is empty where messages are exchanged nevertheless. None if all is well.
    """
    verb = "publishes" if theirs.kind == "MP" else "subscribes to"
    does = f"node {theirs.full_name} {verb} {theirs.topic} as {theirs.type_name}"
    if theirs.type_name != ours.type_name:
        return "ROS003", f"{does}, here it is {ours.type_name}"
    if theirs.type_hash != ours.type_hash:
        there, here = _short(theirs.type_hash), _short(ours.type_hash)
        return "ROS003", f"{does} with another definition (type hash {there} there, {here} here)"
    offered, requested = (theirs, ours) if theirs.kind == "MP" else (ours, theirs)
    if problem := incompatibility(offered.qos or Qos(), requested.qos or Qos()):
        return "", f"{does}, but {problem}; over Zenoh messages are exchanged nevertheless"
    return None


def _short(type_hash: str) -> str:
    if type_hash == NO_TYPE_HASH:
        return "none, as on Humble"
    return f"{type_hash.removeprefix('RIHS01_')[:8]}…"
