"""The table of channels.

Every figure changes at every look. The widget draws the lines that are on the screen and nothing else;
textual's own table keeps cells for all rows, and took three times the processor time.
"""

from __future__ import annotations

from itertools import accumulate
from typing import ClassVar

from rich.segment import Segment
from rich.style import Style
from textual.binding import Binding, BindingType
from textual.events import Click, Resize
from textual.geometry import Size
from textual.message import Message
from textual.scroll_view import ScrollView
from textual.strip import Strip

from rosplc.monitor.picture import ChannelView
from rosplc.monitor.terminal.columns import Sorting, columns_for, fitted, heading
from rosplc.monitor.terminal.style import LEVEL_STYLES

__all__ = ["ChannelTable"]

_HEADING = Style(bold=True, underline=True)
_CURSOR = Style(reverse=True)


class ChannelTable(ScrollView, can_focus=True):
    """Shows channels in an order; the cursor follows its channel."""

    class Highlighted(Message):
        """The cursor stands on another channel."""

    class Opened(Message):
        """A channel was chosen, by Enter or a second click."""

    class HeadingClicked(Message):
        """A heading was clicked.

        Attributes:
            by: The name of the order that it stands for.
        """

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
        self._views: list[ChannelView] = []
        self._sorting = Sorting()
        self._row = 0

    @property
    def chosen(self) -> ChannelView | None:
        """The channel under the cursor; None if there are no channels."""
        return self._views[self._row] if self._row < len(self._views) else None

    def show(self, channels: list[ChannelView], order: Sorting) -> None:
        """Show channels.

        Args:
            channels: The channels, in order.
            order: Their order, for the headings.
        """
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
