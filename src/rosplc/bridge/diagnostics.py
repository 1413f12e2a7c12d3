"""What the bridge publishes on ``/diagnostics``: a status for itself, each topic, service and action."""

from __future__ import annotations

import struct
from collections.abc import Mapping
from typing import Any

from rosplc.bridge.status import BridgeStatus, CallStatus, TopicStatus, format_age
from rosplc.clock import SYSTEM, Clock
from rosplc.model import TypeStore
from rosplc.ros import DEFAULT, Backend, Publisher, fields

TOPIC = "/diagnostics"
TYPE = "diagnostic_msgs/msg/DiagnosticArray"
_STATUS = "diagnostic_msgs/msg/DiagnosticStatus"

_CALLS = (
    *("matched", "received", "done", "succeeded", "aborted", "canceled"),
    *("unreadable", "late", "outstanding", "strays", "feedback", "goal_status"),
)
_COUNTERS = ("received", "published", "skipped", "lost", "refused", "truncated", "substituted", "recovered")
_TEXT = 240
_PER_MESSAGE = 32
"""Statuses in one message; aggregators merge by name, and small messages pass every transport."""


class Diagnostics:
    """Publishes a bridge's status."""

    def __init__(self, store: TypeStore, backend: Backend, clock: Clock = SYSTEM) -> None:
        self._store, self._clock = store, clock
        self._publisher: Publisher = backend.advertise(TOPIC, TYPE, DEFAULT)
        self._packed: dict[str, tuple[dict[str, Any], int, bytes]] = {}

    def publish(self, status: BridgeStatus) -> None:
        """Send the status, in as many messages as it takes. Raises RosplcError: The middleware refused."""
        now = self._clock.time_ns()
        header = {"stamp": fields.time(now)}
        before = fields.pack(self._store, TYPE, {"header": header})[:-4]  # without the number of statuses
        entries = diagnostic_statuses(status)
        for at in range(0, len(entries), _PER_MESSAGE):
            some = entries[at : at + _PER_MESSAGE]
            message = bytearray(before + struct.pack("<I", len(some)))
            for entry in some:
                message += self._pack(entry, len(message) % 4)
            self._publisher.write(bytes(message), now)

    def _pack(self, entry: dict[str, Any], at: int) -> bytes:
        # Most topics tell the same as a second ago, and packing their texts is what costs.
        known = self._packed.get(entry["name"])
        if known is None or known[:2] != (entry, at):
            known = entry, at, fields.pack_part(self._store, _STATUS, _fitting(entry), at)
            self._packed[entry["name"]] = known
        return known[2]

    def close(self) -> None:
        """Leave the topic."""
        self._publisher.close()


def diagnostic_statuses(status: BridgeStatus) -> list[dict[str, Any]]:
    """Return the bridge's status, then its topics': DiagnosticStatus' fields, ``values`` as a mapping."""
    name = f"rosplc: {status.bridge}"
    level, message = status.judgement
    values = {
        "backend": status.backend,
        "backend chosen": status.backend_why,
        "uptime": format_age(status.uptime_ns),
        "topics": str(len(status.topics)),
    }
    if status.services:
        values["services"] = str(len(status.services))
    if status.actions:
        values["actions"] = str(len(status.actions))
    entries = [_entry(int(level), name, message, values, status.bridge)]
    for topic in status.topics:
        level, message = topic.judgement
        entries.append(_entry(int(level), f"{name}: {topic.topic}", message, _values(topic), status.bridge))
    for use in status.calls:
        level, message = use.judgement
        entries.append(_entry(int(level), f"{name}: {use.name}", message, _call_values(use), status.bridge))
    return entries


def _entry(level: int, name: str, message: str, values: Mapping[str, str], hardware: str) -> dict[str, Any]:
    return {"level": level, "name": name, "message": message, "hardware_id": hardware, "values": values}


def _fitting(entry: dict[str, Any]) -> dict[str, Any]:
    """Return an entry as the message has it, its texts cut."""
    texts = {key: _fit(entry[key]) for key in ("name", "message", "hardware_id")}
    values = [{"key": key, "value": _fit(value)} for key, value in entry["values"].items()]
    return {"level": entry["level"], **texts, "values": values}


def _values(topic: TopicStatus) -> dict[str, str]:
    values = {
        "type": topic.type_name,
        "direction": topic.direction.word,
        "rate [Hz]": f"{topic.rate_hz:.4g}",
        "age": "never" if topic.age_ns is None else format_age(topic.age_ns),
        "matched": str(topic.matched),
        "PLC alive": "unknown" if topic.peer_alive is None else str(topic.peer_alive),
        **{name: str(getattr(topic, name)) for name in _COUNTERS},
        "reason": topic.reason,
    }
    if topic.deadlines_missed:
        values["deadlines missed"] = str(topic.deadlines_missed)
    if (classic := topic.classic) is not None:
        values["classic memory"] = f"{classic.memory}, {classic.bytes} bytes"
        values["lock"] = classic.lock
    return values


def _call_values(use: CallStatus) -> dict[str, str]:
    values = {"type": use.type_name, "server": use.server, "PLC alive": str(use.peer_alive)}
    values |= {name: str(getattr(use, name)) for name in _CALLS if hasattr(use, name)}
    for what, reasons in (("not executed", use.not_executed), ("fate unknown", use.fate_unknown)):
        values[what] = ", ".join(f"{count} {reason}" for reason, count in reasons.items()) or "0"
    return values | {"reason": use.reason}


def _fit(text: str) -> str:
    """Cut a long text between characters, without NUL."""
    return text.replace("\0", " ").encode()[:_TEXT].decode(errors="ignore")
