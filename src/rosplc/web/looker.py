"""The looks themselves: what one thread does with the watch, and only for what some page wants."""

from __future__ import annotations

import time
from collections.abc import Iterable, Set
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

from rosplc.errors import RosplcError
from rosplc.web.form import shown
from rosplc.web.wants import number_at

if TYPE_CHECKING:
    from rosplc.monitor.message import Message
    from rosplc.monitor.picture import Picture
    from rosplc.monitor.watch import Watch
    from rosplc.web.wants import Wants

__all__ = ["Look", "Looker"]

_PICTURE_SECONDS = 0.5
_IDLE_SECONDS = 1.0
_SAMPLE_SECONDS = 0.05
# What a look, or decoding a large message, costs may be at most this share of the time.
_SHARE = 0.2
_STAMP_MS = 500


@dataclass
class Look:
    """What one turn of looking has found.

    Attributes:
        picture: All channels, if it was time for them.
        messages: Of each wanted channel whose message is new, what is shown of it, by id.
        samples: Per plotted channel the time in ms since 1970 and its fields' values by path.
    """

    picture: Picture | None = None
    messages: dict[str, dict[str, Any]] = field(default_factory=dict)
    samples: dict[str, tuple[float, dict[str, float | None]]] = field(default_factory=dict)


class Looker:
    """Takes looks; for one thread.

    Args:
        watch: What to look with.
    """

    def __init__(self, watch: Watch) -> None:
        self._watch = watch
        self._due: dict[str, float] = {}
        self._seen: dict[str, tuple[object, ...]] = {}

    def look(self, wanted: Iterable[Wants]) -> Look:
        """Look at what pages want, as far as it is time to.

        Raises:
            RosplcError: The channels cannot be listed.
        """
        wanted = list(wanted)
        messages: Set[str] = frozenset().union(*(each.messages for each in wanted))
        plots: dict[str, set[str]] = {}
        for each in wanted:
            for channel, paths in each.plots.items():
                plots.setdefault(channel, set()).update(paths)
        found = Look()
        if self._is_due(""):
            started = time.monotonic()
            found.picture = self._watch.look()
            self._next("", started, _PICTURE_SECONDS if wanted else _IDLE_SECONDS)
        for channel in messages | plots.keys():
            if self._is_due(channel):
                started = time.monotonic()
                self._message(found, channel, channel in messages, frozenset(plots.get(channel, ())))
                self._next(channel, started, _SAMPLE_SECONDS)
        for channel in self._due.keys() - messages - plots.keys() - {""}:
            del self._due[channel]
            self._seen.pop(channel, None)
        return found

    def _is_due(self, name: str) -> bool:
        return time.monotonic() >= self._due.get(name, 0.0)

    def _next(self, name: str, started: float, seconds: float) -> None:
        now = time.monotonic()
        # A little early rather than a turn late: the turns themselves come at this distance.
        self._due[name] = max(started + 0.8 * seconds, now + (now - started) * (1 / _SHARE - 1))

    def _message(self, found: Look, channel: str, wanted: bool, paths: Set[str]) -> None:
        try:
            message = self._watch.message(channel)
        except RosplcError as error:
            self._news(found, channel, ("error", error.code), {"error": error.to_dict()})
            return
        if message is None:
            self._news(found, channel, ("none",), {"none": True})
            return
        mark = ("message", message.sequence, message.stamp_ns, message.type_name)
        # A classic topic's messages have no numbers: each look may have found a new one.
        if message.sequence and self._seen.get(channel) == (*mark, wanted, paths):
            return
        self._seen[channel] = (*mark, wanted, paths)
        now_ms = time.time_ns() / 1e6
        if paths:
            values = {path: number_at(message.values, path) for path in paths}
            found.samples[channel] = (_time_of(message, now_ms), values)
        if wanted:
            found.messages[channel] = _page_form(message)

    def _news(self, found: Look, channel: str, mark: tuple[object, ...], news: dict[str, Any]) -> None:
        if self._seen.get(channel) != mark:
            self._seen[channel] = mark
            found.messages[channel] = news


def _time_of(message: Message, now_ms: float) -> float:
    """Return when a message came: its stamp, if that is of about now, which is more exact than a look."""
    stamp_ms = message.stamp_ns / 1e6
    return stamp_ms if message.clock and 0 <= now_ms - stamp_ms < _STAMP_MS else now_ms


def _page_form(message: Message) -> dict[str, Any]:
    return {
        "type": message.type_name,
        "sequence": message.sequence,
        # Nanoseconds since 1970 are beyond what a page can count.
        "stamp_ms": message.stamp_ns / 1e6 if message.stamp_ns else None,
        "clock": message.clock,
        "marks": list(message.marks),
        "values": shown(message.values),
    }
