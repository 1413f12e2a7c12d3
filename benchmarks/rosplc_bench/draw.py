"""Figures as data, and as PNG and SVG: the only module that knows matplotlib; and how a number is written."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeAlias

from rosplc.errors import SetupError

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


_MARKERS = "osD^vP*Xhp<>d"
_MOST_TICKS = 10
_GROUPS = {"reference": "#777777", "rosplc": "#cc3311"}
_PLAIN = "#4477aa"
_COLOURS = (
    "#0077bb", "#33bbee", "#009988", "#ee7733", "#ee3377", "#332288", "#88ccee", "#117733", "#999933",
    "#ddcc77", "#aa4499", "#882255", "#661100",
)  # fmt: skip
_WIDTH, _HEIGHT, _DPI = 9.0, 5.2, 130


def available() -> bool:
    """Return whether figures can be drawn here."""
    try:
        import matplotlib  # noqa: F401
    except ImportError:
        return False
    return True


def draw(figure: Figure, folder: Path) -> list[Path]:
    """Write a figure as ``NAME.png`` and ``NAME.svg``; return the files.

    Raises:
        SetupError: SYS001, matplotlib is missing.
    """
    try:
        import matplotlib as mpl
    except ImportError as error:
        raise SetupError(
            "SYS001", "the Python package matplotlib is missing", remedy="pip install rosplc-bench"
        ) from error
    mpl.use("Agg")  # no display is needed, and none is looked for
    from matplotlib import pyplot

    style: dict[Any, Any] = {
        "svg.hashsalt": "rosplc",  # the same text for the same figure: no random ids, and no date below
        "svg.fonttype": "none",  # words stay words, a quarter of the size of their outlines
        "font.size": 10,
        "axes.grid": True,
        "grid.alpha": 0.3,
    }
    with mpl.rc_context(style):
        height = max(_HEIGHT, 0.36 * len(figure.series) + 1.5) if figure.kind == "bars" else _HEIGHT
        drawing, axes = pyplot.subplots(figsize=(_WIDTH, height), layout="constrained")
        if figure.kind == "bars":
            _bars(axes, figure)
        else:
            _lines(axes, figure)
        axes.set_title(figure.title, fontsize=11, loc="left", wrap=True)
        paths = [folder / f"{figure.name}.{ending}" for ending in ("png", "svg")]
        drawing.savefig(paths[0], dpi=_DPI, metadata={"Software": None})
        drawing.savefig(paths[1], metadata={"Date": None, "Creator": None})
        pyplot.close(drawing)
    return paths


def _lines(axes: Any, figure: Figure) -> None:
    colours, markers = iter(_COLOURS), iter(_MARKERS * 2)
    for series in figure.series:
        own = _GROUPS.get(series.group)
        axes.plot(
            series.x,
            series.y,
            marker=next(markers),
            markersize=5,
            linewidth=2.4 if series.group == "rosplc" else 1.4,
            linestyle="--" if series.group == "reference" else "-",
            color=own or next(colours, "#000000"),
            label=series.name,
        )
    if figure.x_log:
        axes.set_xscale("log")
        ticks = sorted({x for series in figure.series for x in series.x})
        if len(ticks) <= _MOST_TICKS:
            axes.set_xticks(ticks, [_tick(tick, figure.x_label) for tick in ticks], minor=False, fontsize=8)
            axes.minorticks_off()
    if figure.y_log:
        axes.set_yscale("log")
    axes.set_xlabel(figure.x_label)
    axes.set_ylabel(figure.y_label)
    _plain_numbers(axes.yaxis, figure.y_label)
    # Beside the lines and in the order of their ends: a dozen names inside would cover what they name.
    handles, names = axes.get_legend_handles_labels()
    ends = {series.name: series.y[-1] if series.y else 0.0 for series in figure.series}
    order = sorted(range(len(names)), key=lambda number: -ends[names[number]])
    axes.legend(
        [handles[number] for number in order],
        [names[number] for number in order],
        loc="center left",
        bbox_to_anchor=(1.01, 0.5),
        fontsize=8,
        frameon=False,
    )


def size_text(size: float) -> str:
    """Return a number of bytes as people read it: in MiB, KiB or B."""
    for unit, name in ((1 << 20, "MiB"), (1 << 10, "KiB")):
        if size >= unit:
            return f"{size / unit:,.0f} {name}"
    return f"{size:,.0f} B"


def _tick(value: float, label: str) -> str:
    return size_text(value).removesuffix(" B") if label == "bytes" else f"{value:,.0f}"


def _plain_numbers(axis: Any, label: str) -> None:
    """Write seconds as µs and ms, and other numbers with thousands apart: few people read powers of ten."""
    from matplotlib import ticker

    if label == "s":
        axis.set_major_formatter(ticker.EngFormatter("s"))
        axis.set_label_text("duration")
    elif axis.get_scale() == "log":
        axis.set_major_formatter(ticker.FuncFormatter(lambda value, _: f"{value:,.12g}"))


def _bars(axes: Any, figure: Figure) -> None:
    names = [series.name for series in figure.series]
    values = [series.y[0] for series in figure.series]
    colours = [_GROUPS.get(series.group, _PLAIN) for series in figure.series]
    bars = axes.barh(range(len(names)), values, color=colours, height=0.7)
    axes.set_axisbelow(True)
    axes.set_yticks(range(len(names)), names, fontsize=9)
    axes.invert_yaxis()
    axes.grid(visible=False, axis="y")
    if figure.y_log and min(values) > 0:
        axes.set_xscale("log")
        low, high = axes.get_xlim()
        axes.set_xlim(low, high * (high / low) ** 0.12)
    else:
        axes.margins(x=0.15)
    axes.bar_label(bars, labels=[cell_text(float(value)) for value in values], padding=3, fontsize=8)
    axes.set_xlabel(figure.y_label)
    _plain_numbers(axes.xaxis, figure.y_label)
