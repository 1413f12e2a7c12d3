"""Quality of service of a topic, in ROS 2's words, and when two settings fit each other.

Only what a message bridge needs: reliability, durability, how many messages wait, and what was promised
about their coming. The rules of :func:`incompatibility` are DDS's "requested versus offered" (DDS 1.4,
2.2.3); in ROS 2 documentation: "About Quality of Service settings", QoS compatibilities.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from rosplc.errors import BackendError

Reliability = Literal["reliable", "best_effort"]
Durability = Literal["volatile", "transient_local"]
History = Literal["keep_last"]

_MOST = 2**31 - 1  # DDS carries a depth as a signed 32-bit number


@dataclass(frozen=True, slots=True)
class Qos:
    """How messages of one topic are carried.

    Attributes:
        reliability: ``reliable`` repeats lost messages, ``best_effort`` does not.
        durability: ``transient_local`` keeps the last ``depth`` messages for readers that
            come later (ROS 1: latched), ``volatile`` keeps none.
        depth: Messages that wait at most; the oldest give way.
        history: ``keep_last`` alone: a queue without a bound has no place beside a PLC.
        deadline_ns: The longest time between two messages that is promised, or asked for; 0: none. Only
            backends with the capability ``deadline`` carry it.
        lease_ns: How long after its last sign of life a publisher counts as gone, as promised or asked for;
            0: none. The middleware gives the signs ("automatic" liveliness). The same capability.

    Raises:
        BackendError: ROS007, if a value is none of these.
    """

    reliability: Reliability = "reliable"
    durability: Durability = "volatile"
    depth: int = 10
    history: History = "keep_last"
    deadline_ns: int = 0
    lease_ns: int = 0

    def __post_init__(self) -> None:
        for name, allowed in _ALLOWED.items():
            if (value := getattr(self, name)) not in allowed:
                raise BackendError("ROS007", f"{name} is {value!r}; it can be {' or '.join(allowed)}")
        if not isinstance(self.depth, int) or isinstance(self.depth, bool) or not 1 <= self.depth <= _MOST:
            raise BackendError("ROS007", f"depth is {self.depth!r}; it is a whole number from 1 up")
        for name in ("deadline_ns", "lease_ns"):
            time = getattr(self, name)
            if not isinstance(time, int) or isinstance(time, bool) or not 0 <= time < 2**63 - 1:
                raise BackendError("ROS007", f"{name} is {time!r}; it is a number of nanoseconds, 0 for none")

    @property
    def promises(self) -> bool:
        """Whether anything is promised, or asked for, about the coming of messages."""
        return bool(self.deadline_ns or self.lease_ns)


_ALLOWED: dict[str, tuple[str, ...]] = {
    "reliability": ("reliable", "best_effort"),
    "durability": ("volatile", "transient_local"),
    "history": ("keep_last",),
}

DEFAULT = Qos()
"""ROS 2's default for topics: reliable, volatile, the last 10 messages."""

SENSOR_DATA = Qos(reliability="best_effort", depth=5)
"""ROS 2's sensor data profile: newest data matters, lost data does not."""

LATCHED = Qos(durability="transient_local", depth=1000)
"""What a latched ROS 1 publisher with a queue of 1000 does: late readers get what was sent."""

PRESETS: dict[str, Qos] = {"default": DEFAULT, "sensor_data": SENSOR_DATA, "latched": LATCHED}
"""Preset name, as a configuration writes it → settings."""


def incompatibility(offered: Qos, requested: Qos) -> str | None:
    """Return in words why a publisher and a subscriber do not match, or None if they do.

    Args:
        offered: The publisher's settings.
        requested: The subscriber's settings.
    """
    problems = []
    if offered.reliability == "best_effort" and requested.reliability == "reliable":
        problems.append("the publisher is best_effort, the subscriber wants reliable")
    if offered.durability == "volatile" and requested.durability == "transient_local":
        problems.append("the publisher is volatile, the subscriber wants transient_local")
    for what, offer, wish in (
        ("deadline", offered.deadline_ns, requested.deadline_ns),
        ("liveliness lease", offered.lease_ns, requested.lease_ns),
    ):
        if wish and not 0 < offer <= wish:
            has = f"one of {offer / 1e6:g} ms" if offer else "none"
            problems.append(f"the publisher offers {has}, the subscriber wants a {what} of {wish / 1e6:g} ms")
    return "; ".join(problems) or None
