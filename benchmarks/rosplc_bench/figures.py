"""Figures as data, and how a number is written: what pages and drawings share."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TypeAlias

Cell: TypeAlias = str | int | float | None


@dataclass(frozen=True)
class Series:
    """One line of a figure, or one bar: a y for each x.

    Attributes:
        name: In the legend.
        x: For a bar unused.
        y: For a bar one value.
        group: "reference" is drawn in grey, "rosplc" stands out, everything else is neither.
    """

    name: str
    x: tuple[float, ...]
    y: tuple[float, ...]
    group: str = ""


@dataclass(frozen=True)
class Figure:
    """A drawing, as data.

    Attributes:
        name: The file's name, without its ending.
        title: One line above it; describes how each side waits.
        x_label: With the unit; for bars unused.
        y_label: With the unit.
        series: What is drawn; for ``kind`` "bars" each has one value in ``y``.
        kind: "lines" or "bars" (horizontal, in the order given).
        x_log: Whether the x axis is logarithmic.
        y_log: Whether the y axis is (for bars: the axis of values).
    """

    name: str
    title: str
    x_label: str
    y_label: str
    series: tuple[Series, ...]
    kind: str = "lines"
    x_log: bool = False
    y_log: bool = False


def cell_text(cell: Cell) -> str:
    """Return a cell as people read it: three significant digits, thousands apart."""
    if cell is None:
        return ""
    if isinstance(cell, float):
        if cell != cell or cell in (float("inf"), float("-inf")):
            return str(cell)
        if abs(cell) >= 999.5:
            return f"{round(cell, -max(0, len(str(int(abs(cell)))) - 3)):,.0f}"
        return f"{cell:#.3g}".rstrip(".") if cell else "0"
    return f"{cell:,}" if isinstance(cell, int) else cell
