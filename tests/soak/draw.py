"""The figures of campaigns: what each process held over the rounds, and how long recovery took."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from tests.soak.results import cell_name

Run = Mapping[str, Any]
_PARTS = ("bridge", "plc", "publisher", "subscriber", "hub")


def _plot() -> Any:
    import matplotlib as mpl

    mpl.use("Agg")
    mpl.rcParams["svg.hashsalt"] = "soak"  # the same input gives the same file
    from matplotlib import pyplot as plt

    return plt


def draw_series(run: Run, path: Path) -> None:
    """Draw memory and descriptors of each process over the rounds; a line ends where a process died.

    Args:
        run: A run of compact form.
        path: An SVG or PNG.
    """
    plt = _plot()
    drawn, (memory, files) = plt.subplots(2, 1, sharex=True, figsize=(9, 5))
    rounds, samples = run["samples"]["round"], run["samples"]
    for colour, part in enumerate(name for name in _PARTS if name in samples):
        xs, held, open_ = _gapped(rounds, samples[part])
        memory.plot(xs, [kb / 1024 for kb in held], f"C{colour}", linewidth=0.8, label=part)
        files.plot(xs, open_, f"C{colour}", linewidth=0.8)
    memory.set_title(cell_name(run), fontsize=10)
    memory.set_ylabel("memory of its own, MiB")
    files.set_ylabel("descriptors")
    files.set_xlabel("round")
    memory.legend(loc="lower left", ncols=len(_PARTS), fontsize=8)
    for axis in (memory, files):
        axis.set_ylim(bottom=0)
        axis.grid(alpha=0.3)
    _save(plt, drawn, path)


def _gapped(rounds: Sequence[int], series: Mapping[str, Any]) -> tuple[list[float], list[float], list[float]]:
    """Return rounds, KiB and descriptors with a gap where one process took the place of another."""
    xs: list[float] = []
    held: list[float] = []
    open_: list[float] = []
    before = None
    rows = zip(rounds, series["pid"], series["private_kb"], series["files"], strict=True)
    for number, pid, kb, files in rows:
        if pid is None:
            continue
        if pid != before:
            for line in (xs, held, open_):
                line.append(math.nan)
        # A short stroke, so that a life of one sample shows too.
        xs += [number, number + 0.8]
        held += [kb, kb]
        open_ += [files, files]
        before = pid
    return xs, held, open_


def draw_recovery(runs: Sequence[Run], path: Path) -> None:
    """Draw the recovery times of each kind of fault, all cells together: a dot for each round."""
    plt = _plot()
    times: dict[str, list[float]] = {}
    for run in runs:
        for _, fault, recovery_ms, *_ in run["rounds"]:
            times.setdefault(run["faults"][fault], []).append(max(recovery_ms, 1) / 1000)
    names = sorted(times, key=lambda name: sorted(times[name])[len(times[name]) // 2])
    drawn, axis = plt.subplots(figsize=(9, 0.27 * len(names) + 1))
    for row, name in enumerate(names):
        values = times[name]
        spread = [row + 0.35 * ((index * 0.618) % 1 - 0.5) for index in range(len(values))]
        axis.plot(values, spread, "C0.", markersize=1.5, alpha=0.4, rasterized=True)
        middle = sorted(values)[len(values) // 2]
        axis.plot([middle, middle], [row - 0.35, row + 0.35], "C3", linewidth=2)
    axis.set_yticks(range(len(names)), names, fontsize=8)
    axis.set_xscale("log")
    axis.set_xlabel("seconds until all topics carry new messages again; the bar is the median")
    axis.grid(alpha=0.3)
    _save(plt, drawn, path)


def _save(plt: Any, drawn: Any, path: Path) -> None:
    drawn.tight_layout()
    drawn.savefig(path, dpi=120, metadata={"Date": None} if path.suffix == ".svg" else None)
    plt.close(drawn)
