"""rclpy/qos.py."""

from __future__ import annotations

import copy
from enum import IntEnum
from typing import Any

from rclpy.duration import Duration, Infinite


class QoSPolicyKind(IntEnum):
    INVALID = 1
    DURABILITY = 2
    DEADLINE = 4
    LIVELINESS = 8
    RELIABILITY = 16
    HISTORY = 32


def qos_policy_name_from_kind(policy_kind: int) -> str:
    return QoSPolicyKind(policy_kind).name


class InvalidQoSProfileException(Exception):
    def __init__(self, *args: object) -> None:
        super().__init__("Invalid QoSProfile", *args)


class HistoryPolicy(IntEnum):
    SYSTEM_DEFAULT = 0
    KEEP_LAST = 1
    KEEP_ALL = 2
    UNKNOWN = 3


class ReliabilityPolicy(IntEnum):
    SYSTEM_DEFAULT = 0
    RELIABLE = 1
    BEST_EFFORT = 2
    UNKNOWN = 3


class DurabilityPolicy(IntEnum):
    SYSTEM_DEFAULT = 0
    TRANSIENT_LOCAL = 1
    VOLATILE = 2
    UNKNOWN = 3


class LivelinessPolicy(IntEnum):
    SYSTEM_DEFAULT = 0
    AUTOMATIC = 1
    MANUAL_BY_TOPIC = 3
    UNKNOWN = 4


_KEYS = {
    "history", "depth", "reliability", "durability", "lifespan", "deadline", "liveliness",
    "liveliness_lease_duration", "avoid_ros_namespace_conventions",
}  # fmt: skip


class QoSProfile:
    def __init__(self, **kwargs: Any) -> None:
        assert kwargs.keys() <= _KEYS, f"Invalid arguments passed to constructor: {kwargs.keys()!r}"
        if "history" not in kwargs:
            if "depth" not in kwargs:
                raise InvalidQoSProfileException("History and/or depth settings are required.")
            kwargs["history"] = HistoryPolicy.KEEP_LAST
        if kwargs["history"] == HistoryPolicy.KEEP_LAST and "depth" not in kwargs:
            raise InvalidQoSProfileException("History set to KEEP_LAST without a depth setting.")
        assert isinstance(kwargs.get("depth", 10), int)
        self.history = HistoryPolicy(kwargs["history"])
        self.depth = kwargs.get("depth", 10)
        self.reliability = ReliabilityPolicy(kwargs.get("reliability", 1))
        self.durability = DurabilityPolicy(kwargs.get("durability", 2))
        self.deadline = kwargs.get("deadline", Duration())
        self.liveliness_lease_duration = kwargs.get("liveliness_lease_duration", Duration())
        self.liveliness = LivelinessPolicy(kwargs.get("liveliness", 1))


class QoSCompatibility(IntEnum):
    OK = 0
    WARNING = 1
    ERROR = 2


def discovered(profile: QoSProfile) -> QoSProfile:
    """Return a profile as discovery shows it: what is unspecified is infinite."""
    shown = copy.copy(profile)
    for name in ("deadline", "liveliness_lease_duration"):
        if not getattr(shown, name).nanoseconds:
            setattr(shown, name, Infinite)
    return shown


def _excluding(offered: QoSProfile, wanted: QoSProfile) -> tuple[str, str]:
    """Return policy and words of rmw_dds_common (src/qos.cpp) for what keeps two profiles apart."""
    if (
        offered.reliability == ReliabilityPolicy.BEST_EFFORT
        and wanted.reliability == ReliabilityPolicy.RELIABLE
    ):
        return "RELIABILITY", "ERROR: Best effort publisher and reliable subscription;"
    if (
        offered.durability == DurabilityPolicy.VOLATILE
        and wanted.durability == DurabilityPolicy.TRANSIENT_LOCAL
    ):
        return "DURABILITY", "ERROR: Volatile publisher and transient local subscription;"
    offers, wants = offered.deadline.nanoseconds, wanted.deadline.nanoseconds
    if wants and (not offers or offers > wants):  # infinite is no exception there: an own profile has 0
        return "DEADLINE", "ERROR: Subscription has a deadline, but publisher does not;"
    if wanted.liveliness > offered.liveliness:
        return "LIVELINESS", (
            "ERROR: Publisher's liveliness is automatic and subscription's is manual by topic;"
        )
    return "", ""


def qos_check_compatible(
    publisher_qos: QoSProfile, subscription_qos: QoSProfile
) -> tuple[QoSCompatibility, str]:
    words = _excluding(publisher_qos, subscription_qos)[1]
    return (QoSCompatibility.ERROR if words else QoSCompatibility.OK), words
