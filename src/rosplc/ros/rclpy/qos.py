"""Quality of service in rclpy's words, and back."""

from __future__ import annotations

from typing import Any

from rclpy.qos import DurabilityPolicy, HistoryPolicy, LivelinessPolicy, QoSProfile, ReliabilityPolicy

from rosplc.ros.qos import Qos, incompatibility

__all__ = ["obstacle", "profile", "settings"]

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
