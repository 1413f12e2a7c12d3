"""Quality of service in rclpy's words, and back."""

from __future__ import annotations

from typing import Any

from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy, qos_check_compatible

from rosplc.ros.qos import Qos, incompatibility

__all__ = ["obstacle", "profile", "settings"]


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
        "best_effort" if best_effort else "reliable", "transient_local" if transient else "volatile", 1
    )


def obstacle(offered: Any, requested: Any) -> str | None:
    """Return in words why a publisher's profile does not serve a subscription's, or None if it does."""
    if words := incompatibility(settings(offered), settings(requested)):
        return words
    compatible, reason = qos_check_compatible(offered, requested)
    # Deadline and liveliness: the bridge has no such settings, so the middleware's words serve.
    return str(reason).strip() if compatible.name == "ERROR" else None
