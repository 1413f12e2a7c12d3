"""The newest message of a channel, decoded by its description, and its call, if any (spec, 11.2)."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from typing import Any

from rosplc.layout import Layout
from rosplc.monitor.picture import ASKS, CallView, ChannelView, State
from rosplc.shm import Attached, Part, SlotInfo
from rosplc.shm import constants as spec
from rosplc.shm.calls import ENDS, WORDS

_ASKED = (
    (spec.ASK_CANCEL, "cancel requested"),
    (spec.ASK_PREEMPT, "preempt requested"),
    (spec.ASK_WITHDRAWN, "withdrawn"),
)
_ANSWERS = {
    spec.ANSWER_DONE: "done",
    spec.ANSWER_NOT_EXECUTED: "not executed",
    spec.ANSWER_FATE_UNKNOWN: "fate unknown",
    spec.ANSWER_UNREADABLE: "unreadable",
    spec.ANSWER_ACCEPTED: "accepted",
    spec.ANSWER_SUCCEEDED: "succeeded",
    spec.ANSWER_CANCELED: "canceled",
    spec.ANSWER_ABORTED: "aborted",
}
_ADDED = (
    (spec.ANSWER_CANCEL_ACCEPTED, "canceling"),
    (spec.ANSWER_CANCEL_REJECTED, "cancel rejected"),
    (spec.ANSWER_NO_RESULT, "result omitted (too large)"),
)


def status_words(part: Part, status: int, reason: int) -> str:
    """Return a message's status in words, with the reason: ``not executed: the request was refused``."""
    if part.asks:
        words = [word for bit, word in _ASKED if status & bit] or ["called"]
    else:
        words = [_ANSWERS.get(status & spec.ANSWER_MASK, f"status {status & spec.ANSWER_MASK}")]
        words += [word for bit, word in _ADDED if status & bit]
    why = {int(each): text for each, text in WORDS.items() if each}.get(reason, "")
    return ", ".join(words) + (f": {why}" if why else "")


class Calls:
    """Tracks the calls in one object of a service or action."""

    def __init__(self, attached: Attached) -> None:
        self._attached, self._part = attached, Part(attached.identity.kind)
        self._server = "plc" if self._part.direction("plc") is attached.identity.direction else "ros"
        self._view = CallView(self._server)
        self._last = 0
        self._ended: Counter[str] = Counter()
        self._end = 0

    def look(self, head: int) -> CallView:
        """Return the object's calls, with ``head`` as its newest message."""
        # What was overtaken is still in a slot for a while.
        new = min(head - self._last, self._attached.identity.slot_count - 1) if head > self._last else 1
        for sequence in range(max(1, head - new + 1), head + 1) if head != self._last else ():
            slot = self._attached.slot(sequence)
            if slot is None:
                continue
            words = status_words(self._part, slot.status, slot.reason)
            if (
                not self._part.asks
                and slot.status & spec.ANSWER_MASK in ENDS
                and slot.correlation != self._end
            ):
                self._end = slot.correlation
                self._ended[words] += 1
            number, correlation = slot.correlation & 0xFFFFFFFF, f"{slot.correlation:016x}"
            still = None if self._part.asks else slot.correlation != self._end
            self._view = CallView(self._server, number, correlation, words, still, dict(self._ended))
        self._last = head
        return self._view


def joined(views: Iterable[ChannelView]) -> list[ChannelView]:
    """Return the views, with the outcome of the newest call added to those of requests and goals."""
    views = list(views)
    answers = {
        (view.prefix, view.kind, view.topic, view.client): view.call
        for view in views
        if view.part in ("response", "result") and view.call is not None
    }
    found = []
    for view in views:
        call, answer = view.call, answers.get((view.prefix, view.kind, view.topic, view.client))
        if call is not None and answer is not None and view.part in ASKS:
            # Of one that is withdrawn only the answer tells whether it had begun.
            waits = None if call.status == _ASKED[-1][1] else bool(call.number)
            if call.correlation == answer.correlation:
                call, waits = replace(call, status=answer.status), answer.open
            view = replace(view, call=replace(call, open=waits, ended=answer.ended))
            if view.state is State.OK and call.number:
                now = {True: " is open", False: " has ended", None: ""}[waits]
                view = replace(view, words=f"call {call.number}{now}: {call.status}")
        found.append(view)
    return found


_MARKS = (
    (spec.FLAG_FIRST, "first"),
    (spec.FLAG_TRUNCATED, "truncated"),
    (spec.FLAG_SUBSTITUTED, "substituted"),
)
_CLOCKS = {spec.STAMP_SYSTEM: "system", spec.STAMP_ROS: "ros", spec.STAMP_PLC: "plc"}


@dataclass(frozen=True, slots=True)
class Message:
    """A message, with its values as nested dicts and lists in the order of the type.

    ``channel`` is the channel's id; ``sequence`` is the message's number, 0 for a classic topic, which has
    none; ``stamp_ns`` is the source's time stamp since the epoch of its ``clock``, which is ``system``,
    ``ros`` or ``plc``; 0 and empty without a stamp. ``marks`` contains ``first``, ``truncated`` and
    ``substituted`` if they apply, and a call's number and status.
    """

    channel: str
    type_name: str
    sequence: int
    stamp_ns: int
    clock: str
    marks: tuple[str, ...]
    values: dict[str, Any]

    def as_json(self) -> dict[str, Any]:
        """Return plain data, which may contain NaN and infinity."""
        return {name: getattr(self, name) for name in self.__slots__} | {"marks": list(self.marks)}


def marks_of(flags: int) -> tuple[str, ...]:
    """Return a slot's flags as words."""
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

    ``info`` is the record's slot header; None for a classic topic. ``part`` is the kind of the record.
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

    At most ``elements`` of an array are included. A BOOL is 0 or 1; values that are not finite are omitted.
    """
    if isinstance(values, dict):
        for name, value in values.items():
            yield from numbers(value, elements=elements, path=f"{path}.{name}" if path else name)
    elif isinstance(values, list):
        for index, value in enumerate(values[:elements]):
            yield from numbers(value, elements=elements, path=f"{path}[{index}]")
    elif isinstance(values, (bool, int, float)) and math.isfinite(values):
        yield path, float(values)
