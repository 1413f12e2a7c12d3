"""The columns of the table of channels, how much room each takes, and the order of its rows."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from typing import Any

from rich.cells import cell_len, set_cell_size

from rosplc.harmless import one_line, shorten
from rosplc.monitor.cells import age_text, count_text, plc_text, rate_text, state_text, way_text
from rosplc.monitor.picture import ChannelView
from rosplc.monitor.states import ALL_WELL

__all__ = ["ORDERS", "Column", "Sorting", "columns_for", "fitted", "heading"]


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


_LEAST_TOPIC = 8


@dataclass(frozen=True)
class Column:
    """A column.

    Attributes:
        by: The name of the order that it stands for.
        title: Its heading.
        width: Cells, without the space that follows; 0 takes what is left.
        from_width: How wide the screen must be for it to be shown.
        text: A channel's text in it.
        figure: Whether that is a figure, which stands to the right.
    """

    by: str
    title: str
    width: int
    from_width: int
    text: Callable[[ChannelView], str]
    figure: bool = False


_COLUMNS = (
    Column("state", "  state", 12, 0, state_text),
    Column("topic", "topic", 0, 0, lambda view: view.topic),
    Column("way", "way", 5, 72, way_text),
    Column("rate", "per s", 6, 0, lambda view: rate_text(view.rate_hz), True),
    Column("age", "age", 6, 0, lambda view: age_text(view.age_ns), True),
    Column("lost", "lost", 5, 0, lambda view: count_text(view.lost), True),
    Column("refused", "refd", 5, 0, lambda view: count_text(view.refused), True),
    Column("PLC", "PLC", 5, 0, plc_text),
    Column("bridge", "bridge", 20, 100, lambda view: f"{view.prefix}: {view.bridge}"),
    Column("type", "type", 30, 132, lambda view: view.type_name),
)


def columns_for(width: int) -> list[tuple[Column, int]]:
    """Return the columns that a screen has room for, each with its width in cells."""
    shown = [column for column in _COLUMNS if width >= column.from_width]
    rest = width - sum(column.width + 1 for column in shown)
    return [(column, column.width or max(_LEAST_TOPIC, rest)) for column in shown]


def fitted(column: Column, width: int, view: ChannelView) -> str:
    """Return a channel's text in exactly ``width`` cells; what is too long is shortened in the middle."""
    text = whole = one_line(column.text(view))
    size = width
    while cell_len(text) > width:  # a character may take two cells
        text, size = shorten(whole, size), size - 1
    return text.rjust(width) if column.figure else set_cell_size(text, width)


def heading(column: Column, width: int, order: Sorting) -> str:
    """Return a column's heading in ``width`` cells, marked if the table is sorted by it."""
    mark = "" if column.by != order.by else "▲" if order.reverse else "▼"
    text = f"{column.title}{mark}"
    return text.rjust(width) if column.figure else text.ljust(width)
