"""The newest message of a channel, decoded by the object's own description."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

from rosplc.layout import Layout
from rosplc.monitor.calls import status_words
from rosplc.shm import Part, SlotInfo
from rosplc.shm.constants import (
    FLAG_FIRST,
    FLAG_SUBSTITUTED,
    FLAG_TRUNCATED,
    STAMP_PLC,
    STAMP_ROS,
    STAMP_SYSTEM,
)

_MARKS = ((FLAG_FIRST, "first"), (FLAG_TRUNCATED, "truncated"), (FLAG_SUBSTITUTED, "substituted"))
_CLOCKS = {STAMP_SYSTEM: "system", STAMP_ROS: "ros", STAMP_PLC: "plc"}


@dataclass(frozen=True, slots=True)
class Message:
    """A message, with its values as nested dicts and lists in the order of the type.

    ``channel`` is the channel's id; ``sequence`` its number, 0 for a classic topic, which has none;
    ``stamp_ns`` the source's time stamp since the epoch of its ``clock``, which is ``system``, ``ros`` or
    ``plc``: 0 and empty for none. ``marks`` are those of ``first``, ``truncated`` and ``substituted`` that
    hold, and a call's number and status.
    """

    channel: str
    type_name: str
    sequence: int
    stamp_ns: int
    clock: str
    marks: tuple[str, ...]
    values: dict[str, Any]

    def as_json(self) -> dict[str, Any]:
        """Return plain data; NaN and infinity are still in it."""
        return {name: getattr(self, name) for name in self.__slots__} | {"marks": list(self.marks)}


def marks_of(flags: int) -> tuple[str, ...]:
    """Return a slot's flags in words."""
    return tuple(word for bit, word in _MARKS if flags & bit)


def message_of(
    channel: str,
    layout: Layout,
    record: bytes | bytearray,
    info: SlotInfo | None,
    elements: int | None = None,
    part: Part = Part.TOPIC,
) -> Message:
    """Return a record as a message, at most ``elements`` of each array (None: all).

    ``info`` is the record's slot header; None for a classic topic. ``part``: what the record is.
    """
    values = layout.to_dict(record) if elements is None else layout.excerpt(record, elements)
    if info is None:
        return Message(channel, layout.type_name, 0, 0, "", (), values)
    clock = _CLOCKS.get(info.stamp_clock, "")
    stamp = info.stamp_ns if clock else 0
    marks = marks_of(info.flags)
    if part is not Part.TOPIC:
        number = info.correlation & 0xFFFFFFFF
        marks = (*marks, f"call {number}", status_words(part, info.status, info.reason))
    return Message(channel, layout.type_name, info.sequence, stamp, clock, marks, values)


def numbers(values: Any, *, elements: int = 64, path: str = "") -> Iterator[tuple[str, float]]:
    """Yield the path and value of every number in a message, ``pose.position.x`` or ``ranges[3]``.

    At most ``elements`` of an array are followed. A BOOL is 0 or 1; what is not finite is left out.
    """
    if isinstance(values, dict):
        for name, value in values.items():
            yield from numbers(value, elements=elements, path=f"{path}.{name}" if path else name)
    elif isinstance(values, list):
        for index, value in enumerate(values[:elements]):
            yield from numbers(value, elements=elements, path=f"{path}[{index}]")
    elif isinstance(values, (bool, int, float)) and math.isfinite(values):
        yield path, float(values)
