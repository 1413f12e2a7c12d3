"""Publishes the bridge's ``/diagnostics``: the status of the bridge and of each topic, service and action."""

from __future__ import annotations

import struct
from functools import lru_cache
from typing import Any, TypeAlias

from rosplc.bridge.status import BridgeStatus, CallStatus, TopicStatus, format_age
from rosplc.clock import SYSTEM, Clock
from rosplc.model import TypeStore
from rosplc.ros import DEFAULT, Backend, Publisher, fields

TOPIC = "/diagnostics"
TYPE = "diagnostic_msgs/msg/DiagnosticArray"

_CALLS = (
    *("matched", "received", "done", "succeeded", "aborted", "canceled"),
    *("unreadable", "late", "outstanding", "strays", "feedback", "goal_status"),
)
_COUNTERS = ("received", "published", "skipped", "lost", "refused", "truncated", "substituted", "recovered")
_TEXT = 240
_PER_MESSAGE = 32
"""Statuses in one message; aggregators merge by name, and small messages pass every transport."""

_Told: TypeAlias = "BridgeStatus | TopicStatus | CallStatus"


class Diagnostics:
    """Publishes a bridge's status."""

    def __init__(self, store: TypeStore, backend: Backend, clock: Clock = SYSTEM) -> None:
        self._store, self._clock = store, clock
        self._publisher: Publisher = backend.advertise(TOPIC, TYPE, DEFAULT)
        self._cdr = store.ros_version == 2
        self._packed: dict[int, tuple[_Told, int, bytes]] = {}  # by place: of what, its level, the rest

    def publish(self, status: BridgeStatus) -> None:
        """Send the status in as many messages as needed. Raises RosplcError if the middleware refuses."""
        now = self._clock.time_ns()
        header = {"stamp": fields.time(now)}
        before = fields.pack(self._store, TYPE, {"header": header})[:-4]  # without the number of statuses
        every: tuple[_Told, ...] = (status, *status.topics, *status.calls)
        for at in range(0, len(every), _PER_MESSAGE):
            some = every[at : at + _PER_MESSAGE]
            message = bytearray(before + struct.pack("<I", len(some)))
            for place, one in enumerate(some, at):
                known = self._packed.get(place)
                if known is None or known[0] is not one:  # most topics are as they were a second ago
                    entry = diagnostic_status(one, status.bridge)
                    known = self._packed[place] = one, entry["level"], _rest(entry, cdr=self._cdr)
                message.append(known[1])
                message += (bytes(-len(message) % 4) if self._cdr else b"") + known[2]
            self._publisher.write(bytes(message), now)

    def close(self) -> None:
        """Close the publisher."""
        self._publisher.close()


def diagnostic_status(told: _Told, bridge: str) -> dict[str, Any]:
    """Return one of a bridge's statuses as the fields of DiagnosticStatus; ``values`` is a mapping."""
    name, (level, message) = f"rosplc: {bridge}", told.judgement
    if isinstance(told, BridgeStatus):
        values = {
            "backend": told.backend,
            "backend chosen": told.backend_why,
            "uptime": format_age(told.uptime_ns),
            "topics": str(len(told.topics)),
        }
        uses = {"services": len(told.services), "actions": len(told.actions)}
        values |= {what: str(count) for what, count in uses.items() if count}
    elif isinstance(told, TopicStatus):
        name, values = f"{name}: {told.topic}", _values(told)
    else:
        name, values = f"{name}: {told.name}", _call_values(told)
    return {"level": int(level), "name": name, "message": message, "hardware_id": bridge, "values": values}


def _rest(entry: dict[str, Any], *, cdr: bool) -> bytes:
    """Return the part of an entry that follows its level; in CDR, it starts at a 4-byte boundary."""
    # fields.pack() writes the same bytes in ten times the time, and each active topic changes each second.
    first = [_text(entry[key], cdr) for key in ("name", "message", "hardware_id")]
    values = [_text(text, cdr) for pair in entry["values"].items() for text in pair]
    data = b"".join((*first, struct.pack("<I", len(entry["values"])), *values))
    return data[: len(data) - (-int.from_bytes(values[-1][:4], "little") % 4 if cdr else 0)]


@lru_cache(4096)
def _text(text: str, cdr: bool) -> bytes:
    """Return a text, cut between characters and without NUL; in CDR, padded to the next 4-byte boundary."""
    data = text.replace("\0", " ").encode()[:_TEXT].decode(errors="ignore").encode() + b"\0" * cdr
    return struct.pack("<I", len(data)) + data + (bytes(-len(data) % 4) if cdr else b"")


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
