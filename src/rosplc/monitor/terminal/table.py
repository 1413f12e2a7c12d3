"""The table of channels, its columns and sort orders, and the colours of levels.

Only cells whose content changes are updated.
"""

from __future__ import annotations

import os
import re
from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from typing import Any, ClassVar

from rich.cells import cell_len, set_cell_size
from rich.style import Style
from rich.text import Text
from textual.binding import Binding, BindingType
from textual.coordinate import Coordinate
from textual.widgets import DataTable

from rosplc.harmless import one_line, shorten
from rosplc.levels import Level
from rosplc.monitor import picture

_COLOURS = {Level.OK: "green", Level.WARN: "yellow", Level.ERROR: "red", Level.STALE: "magenta"}
# Without colours a red would become a grey that is hard to read.
_PLAIN = bool(os.environ.get("NO_COLOR"))

LEVEL_STYLES = {
    level: Style(color=None if _PLAIN else colour, bold=level is not Level.OK)
    for level, colour in _COLOURS.items()
}
"""The style of a level's mark and word."""


def plain(text: str, style: str = "") -> Text:
    """Return literal text, without markup or control characters."""
    return Text(one_line(text), style=style, no_wrap=True, end="")


def state_cell(view: picture.ChannelView) -> Text:
    """Return the mark and word of a channel's state, in the colour of its level."""
    return Text(picture.state_text(view), style=LEVEL_STYLES[view.state.level], no_wrap=True, end="")


def _natural(text: str) -> list[tuple[int, str]]:
    """Return a sort key that puts robot2 before robot10."""
    return [(int(part[:18]), "") if part.isdecimal() else (0, part) for part in re.split(r"([0-9]+)", text)]


# The first look at a figure is for what stands out, so that figures begin with the largest.
ORDERS: dict[str, tuple[bool, Callable[[picture.ChannelView], Any]]] = {
    "topic": (False, lambda view: (view.prefix, _natural(view.label))),
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
"""Name → whether the largest comes first, and the sort key."""


@dataclass(frozen=True)
class Sorting:
    """The user's selection: the sort order, ``by`` one of :data:`ORDERS`, and which channels are shown.

    Each of the ``words`` must occur in topic, type, bridge, prefix or state.
    """

    by: str = "topic"
    reverse: bool = False
    words: str = ""
    wrong: bool = False

    def next(self) -> Sorting:
        """Return the sort order by the next column."""
        names = list(ORDERS)
        return replace(self, by=names[(names.index(self.by) + 1) % len(names)], reverse=False)

    def of(self, channels: Iterable[picture.ChannelView]) -> list[picture.ChannelView]:
        """Return the selected channels, sorted; equal ones keep their order."""
        words = self.words.casefold().split()
        found = [view for view in channels if self._wanted(view, words)]
        largest_first, key = ORDERS[self.by]
        return sorted(found, key=key, reverse=largest_first != self.reverse)

    def _wanted(self, view: picture.ChannelView, words: list[str]) -> bool:
        if self.wrong and view.state in picture.ALL_WELL:
            return False
        text = " ".join((view.label, view.type_name, view.bridge, view.prefix, view.state.value)).casefold()
        return all(word in text for word in words)


_LEAST_TOPIC = 8


@dataclass(frozen=True)
class Column:
    """A column, with the name of its sort order.

    Its ``width`` is in cells, without the space that follows; 0 means the remaining width. It is shown on
    screens of at least ``from_width`` cells. A ``figure`` is right-aligned.
    """

    by: str
    title: str
    width: int
    from_width: int
    text: Callable[[picture.ChannelView], str]
    figure: bool = False


_COLUMNS = (
    Column("state", "  state", 12, 0, picture.state_text),
    Column("topic", "topic", 0, 0, lambda view: view.label),
    Column("way", "way", 5, 72, picture.way_text),
    Column("rate", "per s", 6, 0, lambda view: picture.rate_text(view.rate_hz), True),
    Column("age", "age", 6, 0, lambda view: picture.age_text(view.age_ns), True),
    Column("lost", "lost", 5, 0, lambda view: picture.count_text(view.lost), True),
    Column("refused", "refd", 5, 0, lambda view: picture.count_text(view.refused), True),
    Column("PLC", "PLC", 5, 0, picture.plc_text),
    Column("bridge", "bridge", 20, 100, lambda view: f"{view.prefix}: {view.bridge}"),
    Column("type", "type", 30, 132, lambda view: view.type_name),
)


def columns_for(width: int) -> list[tuple[Column, int]]:
    """Return the columns that fit on a screen, each with its width in cells."""
    shown = [column for column in _COLUMNS if width >= column.from_width]
    rest = width - sum(column.width + 1 for column in shown)
    return [(column, column.width or max(_LEAST_TOPIC, rest)) for column in shown]


def fitted(column: Column, width: int, view: picture.ChannelView) -> str:
    """Return a channel's text in exactly ``width`` cells; long text is shortened in the middle."""
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


class ChannelTable(DataTable[Text]):
    """Shows channels in a given order; the cursor follows its channel."""

    DEFAULT_CSS = """
    ChannelTable { height: 1fr; background: $background; overflow-x: hidden; scrollbar-size-vertical: 1; }
    ChannelTable > .datatable--header { background: $background; text-style: bold underline; }
    ChannelTable > .datatable--cursor { background: $background; text-style: reverse; }
    """
    BINDINGS: ClassVar[list[BindingType]] = [
        Binding("enter", "select_cursor", "Open"),
        Binding("k", "cursor_up", show=False),
        Binding("j", "cursor_down", show=False),
        Binding("home,g", "scroll_top", show=False),
        Binding("end,G", "scroll_bottom", show=False),
    ]

    def __init__(self) -> None:
        super().__init__(cursor_type="row", cell_padding=0, cursor_foreground_priority="renderable")
        self._views: list[picture.ChannelView] = []
        self._headings: list[str] = []

    @property
    def chosen(self) -> picture.ChannelView | None:
        """The channel under the cursor; None if there are no channels."""
        return self._views[self.cursor_row] if self.cursor_row < len(self._views) else None

    def show(self, channels: list[picture.ChannelView], order: Sorting) -> None:
        """Show channels that are sorted in this order."""
        chosen = self.chosen
        self._views, row = channels, self.cursor_row
        row = next((at for at, view in enumerate(channels) if chosen and view.id == chosen.id), row)
        columns = columns_for(self.size.width)
        headings = [f"{heading(column, size, order)} " for column, size in columns]
        cells = [[_cell(column, size, view) for column, size in columns] for view in channels]
        if headings == self._headings and len(cells) == self.row_count:
            for at, line in enumerate(cells):
                for number, cell in enumerate(line):
                    if self.get_cell_at(place := Coordinate(at, number)) != cell:
                        self.update_cell_at(place, cell)
        else:
            self._headings = headings
            self.clear(columns=True)
            for (column, _), title in zip(columns, headings, strict=True):
                self.add_column(Text(title), width=len(title), key=column.by)
            self.add_rows(cells)
        if row != self.cursor_row:
            self.move_cursor(row=row)


def _cell(column: Column, width: int, view: picture.ChannelView) -> Text:
    style = LEVEL_STYLES[view.state.level] if column.by == "state" else ""
    return Text(f"{fitted(column, width, view)} ", style=style, no_wrap=True, end="")
