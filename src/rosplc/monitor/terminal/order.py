"""Which channels a table shows, and in which order."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from typing import Any

from rosplc.monitor.picture import ChannelView
from rosplc.monitor.states import ALL_WELL

__all__ = ["ORDERS", "Sorting"]


def _natural(text: str) -> list[tuple[int, str]]:
    """Return what sorts robot2 before robot10."""
    return [(int(part[:18]), "") if part.isdecimal() else (0, part) for part in re.split(r"([0-9]+)", text)]


# The first look at a figure is for what stands out, so that figures begin with the largest.
ORDERS: dict[str, tuple[bool, Callable[[ChannelView], Any]]] = {
    "topic": (False, lambda view: (view.prefix, _natural(view.topic))),
    "state": (True, lambda view: view.state.severity),
    "rate": (True, lambda view: view.rate_hz or 0.0),
    "age": (True, lambda view: -1 if view.age_ns is None else view.age_ns),
    "lost": (True, lambda view: view.lost),
    "refused": (True, lambda view: view.refused),
    "PLC": (False, lambda view: view.plc_alive is not False),
    "way": (False, lambda view: view.direction),
    "type": (False, lambda view: view.type_name),
    "bridge": (False, lambda view: (view.prefix, view.bridge)),
}
"""Per name: whether the largest comes first, and what is compared."""


@dataclass(frozen=True)
class Sorting:
    """What a person chose.

    Attributes:
        by: One of :data:`ORDERS`.
        reverse: The other way round.
        words: Only channels in which each of these words stands: in topic, type, bridge, prefix or state.
        wrong: Only channels with which something is wrong.
    """

    by: str = "topic"
    reverse: bool = False
    words: str = ""
    wrong: bool = False

    def sorted_by(self, by: str) -> Sorting:
        """Return the order by another figure; by the same one, the other way round."""
        if by == self.by:
            return replace(self, reverse=not self.reverse)
        return replace(self, by=by, reverse=False)

    def next(self) -> Sorting:
        """Return the order by the figure that comes next."""
        names = list(ORDERS)
        return replace(self, by=names[(names.index(self.by) + 1) % len(names)], reverse=False)

    def of(self, channels: Iterable[ChannelView]) -> list[ChannelView]:
        """Return the channels that are wanted, in order; equal ones stay in theirs."""
        words = self.words.casefold().split()
        found = [view for view in channels if self._wanted(view, words)]
        largest_first, key = ORDERS[self.by]
        return sorted(found, key=key, reverse=largest_first != self.reverse)

    def _wanted(self, view: ChannelView, words: list[str]) -> bool:
        if self.wrong and view.state in ALL_WELL:
            return False
        text = " ".join((view.topic, view.type_name, view.bridge, view.prefix, view.state.value)).casefold()
        return all(word in text for word in words)
