"""The other nodes' endpoints as rclpy shows them, their settings, and why one does not match ours."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any, Literal

from rclpy.qos import DurabilityPolicy, HistoryPolicy, LivelinessPolicy, QoSProfile, ReliabilityPolicy

from rosplc.ros.names import join
from rosplc.ros.qos import Qos, incompatibility

__all__ = ["Peer", "explain", "obstacle", "profile", "read_peers", "settings"]

_INFINITE_NS = 2**31 * 10**9  # DDS's infinite seconds; what middlewares make of it in rmw is longer


def profile(qos: Qos) -> Any:
    """Return rclpy's profile for an endpoint."""
    reliable, transient = qos.reliability == "reliable", qos.durability == "transient_local"
    return QoSProfile(
        history=HistoryPolicy.KEEP_LAST,
        depth=qos.depth,
        reliability=ReliabilityPolicy.RELIABLE if reliable else ReliabilityPolicy.BEST_EFFORT,
        durability=DurabilityPolicy.TRANSIENT_LOCAL if transient else DurabilityPolicy.VOLATILE,
    )


def settings(found: Any) -> Qos:
    """Return the settings of a profile that discovery shows; the depth is not announced and is 1."""
    best_effort = found.reliability == ReliabilityPolicy.BEST_EFFORT
    transient = found.durability == DurabilityPolicy.TRANSIENT_LOCAL
    return Qos(
        "best_effort" if best_effort else "reliable",
        "transient_local" if transient else "volatile",
        1,
        deadline_ns=_bounded(found.deadline),
        lease_ns=_bounded(found.liveliness_lease_duration),
    )


def _bounded(duration: Any) -> int:
    """Return a duration in ns; 0 if it is infinite (as discovery shows it) or unspecified (as here)."""
    ns = int(duration.nanoseconds)
    return ns if 0 < ns < _INFINITE_NS else 0


def obstacle(offered: Any, requested: Any) -> str | None:
    """Return in words why a publisher's profile does not serve a subscription's, or None if it does.

    Not rclpy's own ``qos_check_compatible``: it takes unspecified durations for shorter ones than infinite.
    """
    words = incompatibility(settings(offered), settings(requested))
    if requested.liveliness == LivelinessPolicy.MANUAL_BY_TOPIC != offered.liveliness:
        words = "; ".join(filter(None, (words, "the subscriber wants manual liveliness")))
    return words


# What rmw_dds_common reports for participants that are no ROS nodes.
_NAMELESS = {"", "_NODE_NAME_UNKNOWN_", "_CREATED_BY_BARE_DDS_APP_"}


@dataclass(frozen=True)
class Peer:
    """An endpoint on a topic.

    Attributes:
        node: The full name of its node; empty if it has none.
        direction: ``out`` if it publishes.
        topic: The topic.
        type_name: ``package/msg/Name``.
        profile: rclpy's QoSProfile.
        type_hash: What it announces; empty before ROS 2 Iron.
    """

    node: str
    direction: Literal["in", "out"]
    topic: str
    type_name: str
    profile: Any
    type_hash: str

    @property
    def qos(self) -> Qos:
        """Its settings."""
        return settings(self.profile)

    def __str__(self) -> str:
        name = f"node {self.node}" if self.node else "a participant without a ROS node"
        verb = "publishes" if self.direction == "out" else "subscribes to"
        return f"{name} {verb} {self.topic} as {self.type_name}"


def read_peers(infos: Iterable[Any], topic: str, direction: Literal["in", "out"]) -> tuple[Peer, ...]:
    """Return what ``get_publishers_info_by_topic`` or ``get_subscriptions_info_by_topic`` gave."""
    return tuple(
        Peer(
            "" if info.node_name in _NAMELESS else join(info.node_namespace, info.node_name),
            direction,
            topic,
            info.topic_type,
            info.qos_profile,
            _hash(info),
        )
        for info in infos
    )


def _hash(info: Any) -> str:
    text = str(getattr(info, "topic_type_hash", ""))  # Humble has none
    return text if text.startswith("RIHS") else ""  # INVALID, if the peer announces none


def explain(peer: Peer, type_name: str, type_hash: str, ours: Any) -> tuple[str, str] | None:
    """Return code and words for what keeps a peer from matching our endpoint, or None.

    Args:
        peer: An endpoint of the other kind on our topic.
        type_name: Our type.
        type_hash: Our type hash; empty if there is none to compare.
        ours: Our endpoint's profile.
    """
    if peer.type_name != type_name:
        return "ROS003", f"{peer}, here it is {type_name}"
    if type_hash and peer.type_hash and peer.type_hash != type_hash:
        here, there = type_hash[7:15], peer.type_hash[7:15]
        return "ROS003", f"{peer} with another definition (type hash {there}… there, {here}… here)"
    words = obstacle(peer.profile, ours) if peer.direction == "out" else obstacle(ours, peer.profile)
    return ("ROS004", f"{peer}, but {words}") if words else None
