"""The table of channels: rows are places, so that only what is on the screen costs anything."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import ClassVar

from rich.text import Text
from textual.binding import Binding, BindingType
from textual.coordinate import Coordinate
from textual.events import Resize
from textual.widgets import DataTable

from rosplc.monitor.cells import age_text, count_text, plc_text, rate_text, way_text
from rosplc.monitor.picture import ChannelView
from rosplc.monitor.terminal.order import Order
from rosplc.monitor.terminal.style import plain, right, shortened, state_cell

__all__ = ["ChannelTable"]


@dataclass(frozen=True)
class _Column:
    """A column: its order's name, its heading, its cells' width and from which width on it is shown."""

    by: str
    heading: str
    width: int
    from_width: int
    text: Callable[[ChannelView], str]
    figure: bool = False

    def cell(self, view: ChannelView, width: int) -> Text:
        """Return a channel's cell."""
        if self.by == "state":
            return state_cell(view)
        text = self.text(view)
        return right(text, width) if self.figure else shortened(text, width)


_TOPIC = _Column("topic", "topic", 0, 0, lambda view: view.topic)
_COLUMNS = (
    _Column("state", "  state", 11, 0, lambda view: ""),
    _TOPIC,
    _Column("way", "way", 6, 72, way_text),
    _Column("rate", "per s", 5, 0, lambda view: rate_text(view.rate_hz), True),
    _Column("age", "age", 6, 0, lambda view: age_text(view.age_ns), True),
    _Column("lost", "lost", 5, 0, lambda view: count_text(view.lost), True),
    _Column("refused", "refd", 5, 0, lambda view: count_text(view.refused), True),
    _Column("PLC", "PLC", 5, 0, plc_text),
    _Column("type", "type", 30, 132, lambda view: view.type_name),
    _Column("bridge", "bridge", 20, 100, lambda view: f"{view.prefix}: {view.bridge}"),
)
_LEAST_TOPIC = 8


class ChannelTable(DataTable[Text]):
    """Shows channels in an order; the row under the cursor follows its channel."""

    BINDINGS: ClassVar[list[BindingType]] = [Binding("enter", "select_cursor", "Open")]

    def __init__(self) -> None:
        super().__init__(cursor_type="row", cell_padding=0, zebra_stripes=False)
        self._columns: tuple[_Column, ...] = ()
        self._shown: list[ChannelView] = []
        self._cells: dict[Coordinate, Text] = {}
        self._topic_width = _LEAST_TOPIC
        self._order = Order()
        self._chosen: str = ""

    @property
    def chosen(self) -> ChannelView | None:
        """The channel under the cursor."""
        row = self.cursor_row
        return self._shown[row] if 0 <= row < len(self._shown) else None

    def show(self, channels: list[ChannelView], order: Order) -> None:
        """Show channels, which are in order already.

        Args:
            channels: The channels, one per row.
            order: Their order, for the headings.
        """
        if order != self._order:
            self._order = order
            self._build()
        chosen = self.chosen
        if chosen is not None:
            self._chosen = chosen.id
        self._shown = channels
        self._fit_rows()
        row = next((row for row, view in enumerate(channels) if view.id == self._chosen), None)
        if row is not None and row != self.cursor_row:
            self.move_cursor(row=row, scroll=self.has_focus)
        self._fill()

    def on_mount(self) -> None:
        """Make the columns."""
        self._build()

    def on_resize(self, event: Resize) -> None:
        """Make other columns where there is other room."""
        self._build()
        self._fit_rows()
        self._fill()

    def watch_scroll_y(self, old_value: float, new_value: float) -> None:
        """Fill the rows that came into view."""
        super().watch_scroll_y(old_value, new_value)
        self._fill()

    def _build(self) -> None:
        width = self.size.width
        if not width:
            return
        self._columns = tuple(column for column in _COLUMNS if width >= column.from_width)
        # One cell is kept for the scroll bar.
        taken = sum(column.width + 1 for column in self._columns) + 1
        self._topic_width = max(_LEAST_TOPIC, width - taken)
        row, count = self.cursor_row, self.row_count
        self.clear(columns=True)
        self._cells.clear()
        for column in self._columns:
            mark = " " if column.by != self._order.by else "^" if self._order.reverse else "v"
            size = self._width(column)
            text = f"{column.heading}{mark}".rstrip()
            heading = right(text, size, "bold") if column.figure else plain(text, "bold")
            self.add_column(heading, width=size + 1, key=column.by)
        for _ in range(count):
            self._add_place()
        if count:
            self.move_cursor(row=min(row, count - 1))

    def _width(self, column: _Column) -> int:
        return self._topic_width if column is _TOPIC else column.width

    def _add_place(self) -> None:
        self.add_row(*(Text() for _ in self._columns))

    def _fit_rows(self) -> None:
        if not self._columns:
            return
        while self.row_count < len(self._shown):
            self._add_place()
        while self.row_count > len(self._shown):
            row = self.row_count - 1
            self.remove_row(self.coordinate_to_cell_key(Coordinate(row, 0)).row_key)
            for at in range(len(self._columns)):
                self._cells.pop(Coordinate(row, at), None)

    def _fill(self) -> None:
        first = max(0, int(self.scroll_y) - 1)
        for row in range(first, min(first + self.size.height + 2, self.row_count, len(self._shown))):
            view = self._shown[row]
            for at, column in enumerate(self._columns):
                cell = column.cell(view, self._width(column))
                place = Coordinate(row, at)
                if self._cells.get(place) != cell:
                    self._cells[place] = cell
                    self.update_cell_at(place, cell)
