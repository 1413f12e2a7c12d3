"""What the bridge publishes on ``/diagnostics``: one status for itself and one per topic, service or action.

Each status is packed into a record of a generous layout, only if it has changed; the message is then encoded.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from rosplc.bridge.status import BridgeStatus, CallStatus, TopicStatus, format_age
from rosplc.clock import SYSTEM, Clock
from rosplc.codec import Codec, Wire
from rosplc.layout import Limits, compute_layout
from rosplc.model import TypeStore
from rosplc.ros import DEFAULT, Backend, Publisher

TOPIC = "/diagnostics"
TYPE = "diagnostic_msgs/msg/DiagnosticArray"
_STATUS = "diagnostic_msgs/msg/DiagnosticStatus"

_VALUES = 20
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
        self._clock = clock
        fields = {"status": _PER_MESSAGE, "status[].values": _VALUES}
        self._layout = compute_layout(store, TYPE, Limits(string=_TEXT, sequence=_VALUES, fields=fields))
        self._codec = Codec(self._layout, Wire.ROS1 if store.ros_version == 1 else Wire.CDR)
        self._one = compute_layout(store, _STATUS, Limits(string=_TEXT, fields={"values": _VALUES}))
        self._offset = next(offset for path, offset, _ in self._layout.fields() if path == "status")
        self._publisher: Publisher = backend.advertise(TOPIC, TYPE, DEFAULT)
        self._count_offset = self._offset - 4  # header first, then the count right before its elements
        self._empty: dict[int, bytes] = {}
        self._packed: dict[str, tuple[dict[str, Any], bytes]] = {}

    def publish(self, status: BridgeStatus) -> None:
        """Send the status, in as many messages as it takes. Raises RosplcError: The middleware refused."""
        now = self._clock.time_ns()
        entries = diagnostic_statuses(status)
        for at in range(0, len(entries), _PER_MESSAGE):
            self._publisher.write(self._message(entries[at : at + _PER_MESSAGE], now), now)

    def _message(self, entries: list[dict[str, Any]], now_ns: int) -> bytes:
        # An int32 in ROS 2; from 2038 on its bits are those of ROS 1's uint32, which lasts until 2106.
        seconds = (now_ns // 10**9 + 2**31) % 2**32 - 2**31
        stamp = {"sec": seconds, "nanosec": now_ns % 10**9}
        size, count = self._one.size, len(entries)
        if count not in self._empty:
            self._empty[count] = bytes(self._layout.pack({"status": [{}] * count}))
        record = bytearray(self._empty[count])
        header = self._layout.pack({"header": {"stamp": stamp}})
        record[: self._count_offset] = header[: self._count_offset]
        for index, entry in enumerate(entries):
            start = self._offset + index * size
            record[start : start + size] = self._pack(entry)
        return self._codec.encode(record)

    def _pack(self, entry: dict[str, Any]) -> bytes:
        # Most topics say the same as a second ago, and packing their text is what costs.
        known = self._packed.get(entry["name"])
        if known is None or known[0] != entry:
            known = self._packed[entry["name"]] = (entry, bytes(self._one.pack(_fitting(entry))))
        return known[1]

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
    """Return an entry as the message has it, its texts cut to the record's capacity."""
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
    """Cut a text to what the record holds, between characters, without NUL."""
    return text.replace("\0", " ").encode()[:_TEXT].decode(errors="ignore")
