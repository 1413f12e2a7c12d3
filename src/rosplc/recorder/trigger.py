"""What makes a recording be saved: silence, errors, or a value in a message.

::

stale                       a topic became older than it may
error                       refused, lost, a bridge or a PLC gone, an object damaged
/plc/status.fault           the field becomes true, or other than 0
/tank.level > 0.9           the comparison becomes true
/axis.names[2] == 'gripper'

A field triggers with the message in which its condition becomes true after one in which it was not; every
message is checked, also those between two looks of a slow observer.
"""

from __future__ import annotations

import operator
import re
from collections import deque
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

from rosplc.errors import RecordingError
from rosplc.layout import Layout, RecordView
from rosplc.layout.nodes import ArrayNode, SequenceNode, StringNode
from rosplc.monitor import Event
from rosplc.recorder.carried import Stream
from rosplc.recorder.inlet import OnMessage

_KINDS = {"stale": ("stale",), "error": ("refused", "lost", "plc-gone", "bridge-gone", "unreadable")}
"""Word → the kinds of events that it stands for."""
_OPERATORS: dict[str, Callable[[Any, Any], bool]] = {
    "==": operator.eq, "!=": operator.ne, ">=": operator.ge, "<=": operator.le,
    ">": operator.gt, "<": operator.lt,
}  # fmt: skip
_STEP = r"[A-Za-z][A-Za-z0-9_]*(?:\[[0-9]{1,8}\])?"
_CONDITION = re.compile(
    rf"(?P<topic>(?:/[A-Za-z_][A-Za-z0-9_]*)+)\.(?P<path>{_STEP}(?:\.{_STEP})*)"
    r"\s*(?:(?P<operator>==|!=|>=|<=|>|<)\s*(?P<value>.+?))?\s*"
)
_NUMBER = re.compile(r"[+-]?(?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:[eE][+-]?[0-9]{1,3})?")


@dataclass(frozen=True)
class Condition:
    """A condition on one field, ``pose.position.x`` or ``codes[2]``; without operator: true, or not 0."""

    text: str
    topic: str
    path: str
    operator: str = ""
    value: bool | int | float | str | None = None

    def check(self, layout: Layout) -> None:
        """Raise RecordingError REC005 unless a type has the field, and it can be compared so."""
        nodes = {path: node for path, _, node in layout.fields()}
        wanted = re.sub(r"\[[0-9]+\]", "[]", self.path)
        node = nodes.get(wanted)
        if node is None:
            last = wanted.split(".")[-1]
            known = [path for path in nodes if path.split(".")[-1] == last] or list(nodes)
            listed = ", ".join(known[:8]) + (", …" if len(known) > 8 else "")
            raise self._wrong(f"{layout.type_name} has no field {self.path}; it has {listed}")
        if isinstance(node, (ArrayNode, SequenceNode)):
            raise self._wrong(f"{self.path} has several elements; name one, such as {self.path}[0]")
        if isinstance(node, StringNode):
            if not isinstance(self.value, str) or self.operator not in ("==", "!="):
                raise self._wrong(f"{self.path} is text: compare it with == or != and a text in quotes")
        elif isinstance(self.value, str):
            raise self._wrong(f"{self.path} is no text: compare it with a number, true or false")

    def _wrong(self, what: str) -> RecordingError:
        return RecordingError("REC005", what, where=self.text)

    def holds(self, message: RecordView) -> bool:
        """Return whether the condition holds; an element that a sequence does not have fulfils none."""
        value: Any = message
        for step in self.path.split("."):
            name, bracket, index = step.partition("[")
            value = getattr(value, name)
            if bracket:
                at = int(index[:-1])
                if at >= len(value):
                    return False
                value = value[at]
        return bool(value) if not self.operator else _OPERATORS[self.operator](value, self.value)


def parse_condition(text: str) -> Condition:
    """Read ``/topic.field``, with a comparison or without; raises RecordingError REC005."""
    found = _CONDITION.fullmatch(text.strip())
    if found is None:
        what = f"{text!r} is neither stale nor error nor a field of a topic"
        raise RecordingError("REC005", what, where="--trigger")
    value = None if found["value"] is None else _value(found["value"], text)
    return Condition(text.strip(), found["topic"], found["path"], found["operator"] or "", value)


def _value(text: str, where: str) -> bool | int | float | str:
    if text.lower() in ("true", "false"):
        return text.lower() == "true"
    if len(text) >= 2 and text[0] == text[-1] and text[0] in "'\"":
        return text[1:-1]
    if _NUMBER.fullmatch(text):
        return int(text) if text.lstrip("+-").isdigit() else float(text)
    what = f"{text} is no number, no true or false, and no text in quotes"
    raise RecordingError("REC005", what, where=where)


class Fired(NamedTuple):
    """A trigger that has fired: when (ns since 1970), and why."""

    time_ns: int
    reason: str


class Triggers:
    """All triggers of a recording; fed by the taking and by the watching thread. REC005: a text is wrong."""

    def __init__(self, texts: Iterable[str]) -> None:
        texts = list(texts)
        self._kinds = {kind for text in texts for kind in _KINDS.get(text, ())}
        self.conditions = tuple(parse_condition(text) for text in texts if text not in _KINDS)
        self._fired: deque[Fired] = deque()
        self.problems: list[RecordingError] = []

    @property
    def watches(self) -> bool:
        """Whether events of channels are needed."""
        return bool(self._kinds)

    def see(self, events: Sequence[Event]) -> None:
        """Look at what happened to channels."""
        for event in events:
            if event.kind in self._kinds:
                self.fire(event.time_ns, f"{event.topic or event.prefix}: {event.kind}: {event.words}")

    def fire(self, time_ns: int, reason: str) -> None:
        """Note that one has fired; from any thread."""
        self._fired.append(Fired(time_ns, reason))

    def take(self) -> list[Fired]:
        """Return what has fired since the last call."""
        return [self._fired.popleft() for _ in range(len(self._fired))]

    def watch(self, stream: Stream) -> OnMessage | None:
        """Return what a stream's messages are to be shown to, or None; a wrong field is a problem."""
        mine = []
        for condition in self.conditions:
            if condition.topic == stream.topic:
                try:
                    condition.check(stream.codec.layout)
                except RecordingError as error:
                    self.problems.append(error)
                else:
                    mine.append(condition)
        if not mine:
            return None
        held = [True] * len(mine)  # what holds from the first message on has not become true

        def look(stream: Stream, data: bytes, time_ns: int) -> None:
            message = stream.codec.layout.view(stream.codec.decode(data))
            for at, condition in enumerate(mine):
                before, held[at] = held[at], condition.holds(message)
                if held[at] and not before:
                    self.fire(time_ns, condition.text)

        return look
