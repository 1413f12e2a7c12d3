"""The columns of the table of channels, and how much room each takes."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from rich.cells import cell_len, set_cell_size

from rosplc.harmless import one_line, shorten
from rosplc.monitor.cells import age_text, count_text, plc_text, rate_text, state_text, way_text
from rosplc.monitor.picture import ChannelView
from rosplc.monitor.terminal.order import Sorting

__all__ = ["Column", "columns_for", "fitted", "heading"]

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
