"""What the objects of services and actions tell of their calls: spec/shm-format.md, section 11.2."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable
from dataclasses import replace

from rosplc.monitor.picture import ASKS, CallView, ChannelView, State
from rosplc.shm import Attached, Part
from rosplc.shm import constants as spec
from rosplc.shm.calls import ENDS, WORDS

_ASKED = (
    (spec.ASK_CANCEL, "to be canceled"),
    (spec.ASK_PREEMPT, "to make room for another"),
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
    (spec.ANSWER_NO_RESULT, "without its result, which does not fit"),
)


def status_words(part: Part, status: int, reason: int) -> str:
    """Return a message's status in words, with the reason: ``not executed: it was refused``."""
    if part.asks:
        words = [word for bit, word in _ASKED if status & bit] or ["called"]
    else:
        words = [_ANSWERS.get(status & spec.ANSWER_MASK, f"status {status & spec.ANSWER_MASK}")]
        words += [word for bit, word in _ADDED if status & bit]
    why = {int(each): text for each, text in WORDS.items() if each}.get(reason, "")
    return ", ".join(words) + (f": {why}" if why else "")


class Calls:
    """Follows the calls in one object of a service or an action."""

    def __init__(self, attached: Attached) -> None:
        self._attached, self._part = attached, Part(attached.identity.kind)
        self._server = "plc" if self._part.direction("plc") is attached.identity.direction else "ros"
        self._view = CallView(self._server)
        self._last = 0
        self._ended: Counter[str] = Counter()
        self._end = 0

    def look(self, head: int) -> CallView:
        """Return what the object tells, its newest message being ``head``."""
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
    """Return views in which those of requests and goals know what became of the newest call."""
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
