"""The other nodes' endpoints as rclpy shows them, and settings in its words."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any, Literal

from rclpy.qos import DurabilityPolicy, HistoryPolicy, LivelinessPolicy, QoSProfile, ReliabilityPolicy

from rosplc.ros.backend import EndpointInfo
from rosplc.ros.names import join
from rosplc.ros.qos import Qos

_INFINITE_NS = 2**31 * 10**9  # DDS's infinite seconds; what middlewares make of it in rmw is longer
# What rmw_dds_common reports for participants that are no ROS nodes.
_NAMELESS = {"", "_NODE_NAME_UNKNOWN_", "_CREATED_BY_BARE_DDS_APP_"}


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


def read_peers(infos: Iterable[Any], topic: str, direction: Literal["in", "out"]) -> list[EndpointInfo]:
    """Return what ``get_publishers_info_by_topic`` or ``get_subscriptions_info_by_topic`` gave."""
    return [
        EndpointInfo(
            topic,
            info.topic_type,
            direction,
            "" if info.node_name in _NAMELESS else join(info.node_namespace, info.node_name),
            settings(info.qos_profile),
            _hash(info),
            _obstacles(info.qos_profile) if direction == "in" else (),
        )
        for info in infos
    ]


def _hash(info: Any) -> str:
    text = str(getattr(info, "topic_type_hash", ""))  # Humble has none
    return text if text.startswith("RIHS") else ""  # INVALID, if the peer announces none


def _obstacles(requested: Any) -> tuple[str, ...]:
    # rclpy's own qos_check_compatible takes unspecified durations for shorter ones than infinite.
    manual = requested.liveliness == LivelinessPolicy.MANUAL_BY_TOPIC
    return ("the subscriber wants manual liveliness",) if manual else ()
