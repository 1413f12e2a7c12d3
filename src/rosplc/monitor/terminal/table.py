"""The table of channels, its columns and orders, and the colours of levels.

Every figure changes at every look. The widget draws only the lines on the screen; textual's own table keeps
cells for all rows, and took three times the processor time.
"""

from __future__ import annotations

import os
import re
from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from itertools import accumulate
from typing import Any, ClassVar

from rich.cells import cell_len, set_cell_size
from rich.segment import Segment
from rich.style import Style
from rich.text import Text
from textual.binding import Binding, BindingType
from textual.events import Click, Resize
from textual.geometry import Size
from textual.message import Message
from textual.scroll_view import ScrollView
from textual.strip import Strip

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
"""How a level's mark and word look."""


def plain(text: str, style: str = "") -> Text:
    """Return text that stands for itself: no markup, and nothing that a terminal acts upon."""
    return Text(one_line(text), style=style, no_wrap=True, end="")


def state_cell(view: picture.ChannelView) -> Text:
    """Return mark and word of a channel's state, in its level's colour."""
    return Text(picture.state_text(view), style=LEVEL_STYLES[view.state.level], no_wrap=True, end="")


def _natural(text: str) -> list[tuple[int, str]]:
    """Return what sorts robot2 before robot10."""
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
"""Per name: whether the largest comes first, and what is compared."""


@dataclass(frozen=True)
class Sorting:
    """What a person chose: the order ``by`` one of :data:`ORDERS`, and which channels.

    Each of the ``words`` must be in topic, type, bridge, prefix or state.
    """

    by: str = "topic"
    reverse: bool = False
    words: str = ""
    wrong: bool = False

    def next(self) -> Sorting:
        """Return the order by the figure that comes next."""
        names = list(ORDERS)
        return replace(self, by=names[(names.index(self.by) + 1) % len(names)], reverse=False)

    def of(self, channels: Iterable[picture.ChannelView]) -> list[picture.ChannelView]:
        """Return the channels that are wanted, in order; equal ones stay in theirs."""
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
    """A column, with the name of its order.

    Its ``width`` in cells is without the space that follows, 0 takes what is left; it is shown on screens of
    ``from_width``. A ``figure`` is aligned to the right.
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
    """Return the columns that a screen has room for, each with its width in cells."""
    shown = [column for column in _COLUMNS if width >= column.from_width]
    rest = width - sum(column.width + 1 for column in shown)
    return [(column, column.width or max(_LEAST_TOPIC, rest)) for column in shown]


def fitted(column: Column, width: int, view: picture.ChannelView) -> str:
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


_HEADING = Style(bold=True, underline=True)
_CURSOR = Style(reverse=True)


class ChannelTable(ScrollView, can_focus=True):
    """Shows channels in an order; the cursor follows its channel."""

    class Highlighted(Message):
        """The cursor is on another channel."""

    class Opened(Message):
        """A channel was chosen, by Enter or a second click."""

    class HeadingClicked(Message):
        """A heading was clicked; ``by`` is the name of its order."""

        def __init__(self, by: str) -> None:
            super().__init__()
            self.by = by

    DEFAULT_CSS = """
    ChannelTable { height: 1fr; background: $background; overflow-x: hidden; scrollbar-size-vertical: 1; }
    """
    BINDINGS: ClassVar[list[BindingType]] = [
        Binding("enter", "open", "Open"),
        Binding("up,k", "move(-1)", show=False),
        Binding("down,j", "move(1)", show=False),
        Binding("pageup", "page(-1)", show=False),
        Binding("pagedown", "page(1)", show=False),
        Binding("home,g", "move(-1000000)", show=False),
        Binding("end,G", "move(1000000)", show=False),
    ]

    def __init__(self) -> None:
        super().__init__()
        self._views: list[picture.ChannelView] = []
        self._sorting = Sorting()
        self._row = 0

    @property
    def chosen(self) -> picture.ChannelView | None:
        """The channel under the cursor; None if there are no channels."""
        return self._views[self._row] if self._row < len(self._views) else None

    def show(self, channels: list[picture.ChannelView], order: Sorting) -> None:
        """Show channels, which are in this order."""
        chosen = self.chosen
        self._views, self._sorting = channels, order
        row = next((at for at, view in enumerate(channels) if chosen and view.id == chosen.id), self._row)
        self._fit()
        self._place(row)

    def render_line(self, y: int) -> Strip:
        """Draw one line: the heading, or a channel."""
        width = self.size.width
        columns = columns_for(width)
        row = y - 1 + int(self.scroll_y)
        if y == 0:
            text = " ".join(heading(column, size, self._sorting) for column, size in columns)
            segments = [Segment(text, _HEADING)]
        elif 0 <= row < len(self._views):
            view = self._views[row]
            cells = [fitted(column, size, view) for column, size in columns]
            # The first column is the state.
            segments = [Segment(cells[0], LEVEL_STYLES[view.state.level]), Segment(" " + " ".join(cells[1:]))]
            if row == self._row:
                segments = list(Segment.apply_style(segments, post_style=_CURSOR))
        else:
            segments = []
        return Strip(segments).adjust_cell_length(width).apply_style(self.rich_style)

    def on_resize(self, event: Resize) -> None:
        """Keep the cursor in sight."""
        self._fit()
        self._place(self._row)

    def on_click(self, event: Click) -> None:
        """Choose a channel, open it by a second click, or sort by a heading."""
        if event.y == 0:
            columns = columns_for(self.size.width)
            ends = accumulate(size + 1 for _, size in columns)
            for (column, _), end in zip(columns, ends, strict=True):
                if event.x < end:
                    self.post_message(self.HeadingClicked(column.by))
                    return
            return
        row = event.y - 1 + int(self.scroll_y)
        if row < len(self._views):
            self._move_to(row)
            if event.chain > 1:
                self.post_message(self.Opened())

    def action_open(self) -> None:
        """Open the channel under the cursor."""
        if self.chosen is not None:
            self.post_message(self.Opened())

    def action_move(self, rows: int) -> None:
        """Move the cursor by so many rows."""
        self._move_to(self._row + rows)

    def action_page(self, pages: int) -> None:
        """Move the cursor by so many screens."""
        self._move_to(self._row + pages * max(1, self.size.height - 1))

    def _fit(self) -> None:
        self.virtual_size = Size(self.size.width, len(self._views) + 1)

    def _move_to(self, row: int) -> None:
        self._place(row)
        self.post_message(self.Highlighted())

    def _place(self, row: int) -> None:
        self._row = max(0, min(row, len(self._views) - 1))
        lines = max(1, self.size.height - 1)
        first = int(self.scroll_y)
        if self._row < first:
            self.scroll_to(y=self._row, animate=False, force=True)
        elif self._row >= first + lines:
            self.scroll_to(y=self._row - lines + 1, animate=False, force=True)
        self.refresh()
