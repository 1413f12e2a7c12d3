"""What the bridge says on ``/diagnostics``: one status for itself and one per topic.

The message is built like any other: packed into a record of a generous layout, then encoded.
"""

from __future__ import annotations

import time
from collections.abc import Mapping
from typing import Any

from rosplc.bridge.status import BridgeStatus, TopicStatus
from rosplc.codec import Codec, Wire
from rosplc.layout import Limits, compute_layout
from rosplc.model import TypeStore
from rosplc.ros import DEFAULT, Backend, Publisher

__all__ = ["TOPIC", "TYPE", "Diagnostics", "diagnostic_array"]

TOPIC = "/diagnostics"
TYPE = "diagnostic_msgs/msg/DiagnosticArray"

_VALUES = 16
_TEXT = 240
_PER_MESSAGE = 32
"""Statuses in one message; aggregators merge by name, and small messages pass every transport."""


class Diagnostics:
    """Publishes a bridge's status.

    Args:
        store: Where the message type comes from.
        bridge: The bridge's name.
        backend: The ROS side.
    """

    def __init__(self, store: TypeStore, bridge: str, backend: Backend) -> None:
        fields = {"status": _PER_MESSAGE, "status[].values": _VALUES}
        self._layout = compute_layout(store, TYPE, Limits(string=_TEXT, sequence=_VALUES, fields=fields))
        self._codec = Codec(self._layout, Wire.ROS1 if store.ros_version == 1 else Wire.CDR)
        self._publisher: Publisher = backend.advertise(TOPIC, TYPE, DEFAULT)
        self._bridge = bridge

    def publish(self, status: BridgeStatus) -> None:
        """Send the status, in as many messages as it takes.

        Raises:
            RosplcError: The middleware refused.
        """
        now = time.time_ns()
        for message in diagnostic_array(status, now):
            self._publisher.write(self._codec.encode(self._layout.pack(message)), now)

    def close(self) -> None:
        """Leave the topic."""
        self._publisher.close()


def diagnostic_array(status: BridgeStatus, now_ns: int) -> list[dict[str, Any]]:
    """Return the status as DiagnosticArray messages of at most 32 statuses each."""
    name = f"rosplc: {status.bridge}"
    level, message = status.judgement
    values = {
        "backend": status.backend,
        "uptime [s]": f"{status.uptime_ns / 1e9:.0f}",
        "topics": str(len(status.topics)),
    }
    entries = [_entry(int(level), name, message, values, status.bridge)]
    for topic in status.topics:
        level, message = topic.judgement
        entries.append(_entry(int(level), f"{name}: {topic.topic}", message, _values(topic), status.bridge))
    stamp = {"sec": now_ns // 10**9, "nanosec": now_ns % 10**9}
    return [
        {"header": {"stamp": stamp}, "status": entries[at : at + _PER_MESSAGE]}
        for at in range(0, len(entries), _PER_MESSAGE)
    ]


def _entry(level: int, name: str, message: str, values: Mapping[str, str], hardware: str) -> dict[str, Any]:
    return {
        "level": level,
        "name": _fit(name),
        "message": _fit(message),
        "hardware_id": hardware,
        "values": [{"key": key, "value": _fit(value)} for key, value in values.items()],
    }


def _values(topic: TopicStatus) -> dict[str, str]:
    return {
        "type": topic.type_name,
        "direction": topic.direction.word,
        "rate [Hz]": f"{topic.rate_hz:.4g}",
        "age [s]": "never" if topic.age_ns is None else f"{topic.age_ns / 1e9:.3f}",
        "matched": str(topic.matched),
        "PLC alive": str(topic.peer_alive),
        "received": str(topic.received),
        "published": str(topic.published),
        "skipped": str(topic.skipped),
        "lost": str(topic.lost),
        "refused": str(topic.refused),
        "truncated": str(topic.truncated),
        "reason": topic.reason,
    }


def _fit(text: str) -> str:
    """Cut a text to what the record holds, between characters, without NUL."""
    return text.replace("\0", " ").encode()[:_TEXT].decode(errors="ignore")
