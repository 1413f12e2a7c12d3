"""From the JSON of one campaign, or of several, to what is shown of them."""

from __future__ import annotations

import math
import statistics
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

LEAST_ROUNDS = 60
"""Rounds of a life from which on it is judged."""
_SETTLED = 10
_MOST_POINTS = 1500
_CERTAIN_Z = 3.3
"""Of Mann and Kendall's test: one life in a thousand without any trend looks like one."""
# What may come over a whole life by itself: descriptors, threads and KiB, and KiB for each round.
_ALLOWED = {"files": (3.0, 0.0), "threads": (3.0, 0.0), "private_kb": (4096.0, 8.0)}


@dataclass(frozen=True)
class Trend:
    """How one quantity of one process went.

    Attributes:
        part: The part of the cell.
        pid: Its process.
        quantity: ``files``, ``threads`` or ``private_kb``.
        rounds: Rounds that were judged.
        begin: The median of their first quarter.
        end: The median of their last quarter.
        slope: Median change per round over all pairs of rounds (Theil and Sen).
        z: How far from chance (Mann and Kendall); above 3.3 it counts as a rise.
    """

    part: str
    pid: int
    quantity: str
    rounds: int
    begin: float
    end: float
    slope: float
    z: float

    @property
    def leak(self) -> bool:
        """Whether it rises, and by more than may come by itself."""
        absolute, per_round = _ALLOWED[self.quantity]
        allowed = max(absolute, per_round * self.rounds)
        return self.z > _CERTAIN_Z and max(self.slope * self.rounds, self.end - self.begin) > allowed


def trends(samples: Sequence[Mapping[str, Any]]) -> list[Trend]:
    """Return the trends of all lives that are long enough.

    Args:
        samples: One for each round, as a campaign's JSON has them.
    """
    lives: dict[tuple[str, int], list[Mapping[str, Any]]] = {}
    for sample in samples:
        for part, usage in sample.items():
            if isinstance(usage, Mapping):
                if part == "bridge":
                    # It holds each object's lock, and reloads change how many there are: two files each.
                    usage = {**usage, "files": usage["files"] - sample.get("objects", 0) / 2}
                lives.setdefault((part, usage["pid"]), []).append(usage)
    return [
        _trend(part, pid, quantity, life)
        for (part, pid), life in lives.items()
        if len(life) >= LEAST_ROUNDS
        for quantity in _ALLOWED
    ]


def leaks(samples: Sequence[Mapping[str, Any]]) -> list[str]:
    """Return in words what grew."""
    return [
        f"{one.part}: {one.quantity} rose from {one.begin:g} to {one.end:g} in {one.rounds} rounds"
        for one in trends(samples)
        if one.leak
    ]


def _trend(part: str, pid: int, quantity: str, life: Sequence[Mapping[str, Any]]) -> Trend:
    skipped = len(life) // 2 if quantity == "private_kb" else _SETTLED
    values = np.array([usage[quantity] for usage in life[skipped:]], dtype=np.float64)
    quarter = max(1, len(values) // 4)
    slope, z = _theil_sen(values)
    return Trend(
        part,
        pid,
        quantity,
        len(values),
        float(np.median(values[:quarter])),
        float(np.median(values[-quarter:])),
        slope,
        z,
    )


def _theil_sen(values: np.ndarray[Any, np.dtype[np.float64]]) -> tuple[float, float]:
    every = -(-len(values) // _MOST_POINTS)
    values = values[::every]
    count = len(values)
    first, second = np.triu_indices(count, 1)
    rises = values[second] - values[first]
    total = float(np.sign(rises).sum())
    _, ties = np.unique(values, return_counts=True)
    variance = (
        count * (count - 1) * (2 * count + 5) - float((ties * (ties - 1) * (2 * ties + 5)).sum())
    ) / 18
    z = 0.0 if total == 0 or variance <= 0 else (total - math.copysign(1, total)) / math.sqrt(variance)
    return float(np.median(rises / (second - first))) / every, z


Run = Mapping[str, Any]
_MOST_SAMPLES = 400
_COLUMNS = ("pid", "files", "threads", "private_kb")


def percentile(values: Sequence[float], share: float) -> float:
    """Return the value below which ``share`` of the values lie: one of them, the nearest."""
    ordered = sorted(values)
    return ordered[min(len(ordered) - 1, round(share * (len(ordered) - 1)))]


def cell_name(run: Run) -> str:
    """Return what a run's cell is called: the backend, and what is special about it."""
    name = {"dds": "DDS", "zenoh": "Zenoh", "rospy": "ROS 1"}[run["backend"]]
    if run["plc"] == "st":
        name += ", executed Structured Text and classic topics"
    if run["spared"]:
        name += f", {' and '.join(run['spared'])} never killed"
    return name


def compact(run: Run) -> dict[str, Any]:
    """Return a campaign's JSON with what its tables and figures need, column by column.

    Samples are thinned to a few hundred; trends are computed before, from all of them.
    """
    faults = sorted({one["fault"] for one in run["log"]})
    samples = run["samples"]
    kept = samples[:: max(1, -(-len(samples) // _MOST_SAMPLES))]
    parts = sorted({name for sample in samples for name, use in sample.items() if isinstance(use, dict)})
    known = (
        *("seed", "backend", "plc", "spared", "peers", "seconds"),
        *("messages", "machine", "violations", "skipped", "cpu_s"),
    )
    pids = {use["pid"] for sample in samples for use in sample.values() if isinstance(use, dict)}
    return {
        **{key: run[key] for key in known},
        "lives": len(pids),
        "faults": faults,
        "rounds": [
            [
                one["number"],
                faults.index(one["fault"]),
                *(_ms(one[key]) for key in ("recovery_s", "fault_s", "check_s")),
            ]
            for one in run["log"]
        ],
        "load": [sample["load"] for sample in samples][:: max(1, -(-len(samples) // _MOST_SAMPLES))],
        "trends": [
            {**vars(one), "slope": round(one.slope, 4), "z": round(one.z, 2), "leak": one.leak}
            for one in trends(samples)
        ],
        "samples": {
            "round": [sample["round"] for sample in kept],
            "objects": [sample["objects"] for sample in kept],
            **{
                part: {column: [sample.get(part, {}).get(column) for sample in kept] for column in _COLUMNS}
                for part in parts
            },
        },
    }


def _ms(seconds: float) -> int:
    return round(seconds * 1000)


def processes(runs: Iterable[Run]) -> int:
    """Return how many processes were started in all runs of compact form."""
    return sum(run["lives"] for run in runs)


def run_table(runs: Iterable[Run]) -> list[str]:
    """Return a Markdown table: one row per run, of compact form."""
    lines = [
        "| cell | seed | nice | PLC and nodes | rounds | kinds of fault | messages | violations | minutes "
        "| load: median, maximum |",
        "| --- | ---: | ---: | --- | ---: | ---: | ---: | ---: | ---: | ---: |",
    ]
    for run in runs:
        load = f"{statistics.median(run['load']):.1f}, {max(run['load']):.1f}"
        lines.append(
            f"| {cell_name(run)} | {run['seed']} | {run['machine']['nice']} | {run['peers']} "
            f"| {len(run['rounds']):,} | {len(run['faults'])} | {run['messages']:,} "
            f"| {len(run['violations'])} | {run['seconds'] / 60:.0f} | {load} |"
        )
    return lines


def recovery_table(runs: Sequence[Run]) -> list[str]:
    """Return a Markdown table: recovery by kind of fault and kind of cell, runs of one kind together.

    Only of runs whose peers were forked: else their start is Python's, and most of a recovery.
    """
    runs = [run for run in runs if run["peers"] == "forked"]
    kinds = {_kind(run): "" for run in runs}
    heads = " | ".join(f"{kind}: rounds | p50 | p99" for kind in kinds)
    lines = [f"| fault | {heads} |", f"| --- |{' ---: | ---: | ---: |' * len(kinds)}"]
    names = sorted({name for run in runs for name in run["faults"]})
    for name in names:
        cells = []
        for kind in kinds:
            times = [
                round_[2] / 1000
                for run in runs
                if _kind(run) == kind and name in run["faults"]
                for round_ in run["rounds"]
                if round_[1] == run["faults"].index(name)
            ]
            if times:
                cells += [
                    str(len(times)),
                    _seconds(statistics.median(times)),
                    _seconds(percentile(times, 0.99)),
                ]
            else:
                cells += ["–", "", ""]
        lines.append(f"| {name} | {' | '.join(cells)} |")
    return lines


def _kind(run: Run) -> str:
    short = {"dds": "DDS", "zenoh": "Zenoh", "rospy": "ROS 1"}[run["backend"]]
    if run["plc"] == "st":
        short += ", Structured Text"
    nice = run["machine"]["nice"]
    return f"{short}, nice {nice}" if nice < 0 else short


def _seconds(value: float) -> str:
    return f"{value:.2f} s" if value < 9.995 else f"{value:.1f} s"


def trend_table(runs: Iterable[Run]) -> list[str]:
    """Return a Markdown table: the longest life of each part of each kind of cell, from begin to end."""
    lines = [
        "| cell | process | rounds in its lifetime | descriptors | threads | private memory "
        "| memory per 100 rounds |",
        "| --- | --- | ---: | ---: | ---: | ---: | ---: |",
    ]
    longest: dict[tuple[str, str], dict[str, Mapping[str, Any]]] = {}
    for run in runs:
        lives: dict[tuple[str, int], dict[str, Mapping[str, Any]]] = {}
        for one in run["trends"]:
            lives.setdefault((one["part"], one["pid"]), {})[one["quantity"]] = one
        for (part, _), life in lives.items():
            best = longest.get((cell_name(run), part))
            if best is None or life["files"]["rounds"] > best["files"]["rounds"]:
                longest[cell_name(run), part] = life
    for (name, part), life in sorted(longest.items()):
        memory = life["private_kb"]
        lines.append(
            f"| {name} | {part} | {life['files']['rounds']} "
            f"| {_change(life['files'])} | {_change(life['threads'])} "
            f"| {memory['begin'] / 1024:.1f} → {memory['end'] / 1024:.1f} MiB "
            f"| {100 * memory['slope']:+.0f} KiB |"
        )
    return lines


def _change(one: Mapping[str, Any]) -> str:
    return f"{one['begin']:g} → {one['end']:g}"
