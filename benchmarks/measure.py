"""What the developers' measurements share: taking turns, tables, a command line.

A benchmark has ``run(rounds)``, which returns a :func:`report`, and calls :func:`main`. Contenders take turns
in every round, so that a slow moment of the machine affects all alike, and what is compared are ratios within
one run. Nothing here asserts a time.
"""

from __future__ import annotations

import argparse
import json
import statistics
import sys
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any

from rosplc_bench.machine import describe, load_average
from rosplc_bench.report import median_ratio, percentile

__all__ = ["environment", "main", "mean_ns", "median_ratio", "percentile", "report", "row", "table", "turns"]

environment = describe


def mean_ns(function: Callable[[], object], batch: int) -> float:
    """Return the mean cost of one call in nanoseconds."""
    start = time.perf_counter_ns()
    for _ in range(batch):
        function()
    return (time.perf_counter_ns() - start) / batch


def turns(
    contenders: Mapping[str, Callable[[], Mapping[str, Iterable[float]]]], rounds: int
) -> dict[str, list[float]]:
    """Let every contender measure once per round; gather what each returns, by name."""
    values: dict[str, list[float]] = {}
    for _ in range(rounds):
        for contender in contenders.values():
            for name, measured in contender().items():
                values.setdefault(name, []).extend(measured)
    return values


def row(name: str, values: Sequence[float], **more: Any) -> dict[str, Any]:
    """Return a table's row: median, 99th percentile, number of values, and ``more``."""
    middle, p99 = statistics.median(values), percentile(values, 99)
    return {"name": name, "median": middle, "p99": p99, "count": len(values), **more}


def table(
    title: str, unit: str, waiting: str, rows: list[dict[str, Any]], facts: Mapping[str, Any] | None = None
) -> dict[str, Any]:
    """Return a table; ``waiting`` describes how each side waits, ``facts`` is what else was found."""
    return {"title": title, "unit": unit, "waiting": waiting, "rows": rows, "facts": dict(facts or {})}


def report(tables: list[dict[str, Any]], before: Mapping[str, Any]) -> dict[str, Any]:
    """Return a benchmark's result: its tables, and the machine before and after."""
    return {"environment": {**before, "load_after": load_average()}, "tables": tables}


def main(run: Callable[..., dict[str, Any]], doc: str | None, rounds: int, **more: float) -> None:
    """Parse the command line, run, and print tables or JSON; ``more``: numbers for ``run``, as options."""
    parser = argparse.ArgumentParser(description=(doc or "").partition("\n")[0])
    parser.add_argument("--rounds", type=int, default=rounds, help=f"default: {rounds}")
    parser.add_argument("--json", action="store_true", help="print everything as JSON")
    for name, value in more.items():
        parser.add_argument(f"--{name}", type=type(value), default=value, help=f"default: {value:g}")
    arguments = parser.parse_args()
    result = run(arguments.rounds, **{name: getattr(arguments, name) for name in more})
    if arguments.json:
        json.dump(result, sys.stdout, indent=2)
        print()
        return
    facts = result["environment"]
    kind = "virtual machine" if facts["virtual"] else "machine"
    print(f"{facts['when']}  {facts['processor']}, {facts['cores']} cores, {kind}, {facts['kernel']}")
    versions = ", ".join(f"{name} {number}" for name, number in facts["versions"].items())
    print(f"Python {facts['python']}, {versions}, {facts['compiler']}")
    print(f"load average {facts['load_before']} before, {facts['load_after']} after")
    for one in result["tables"]:
        print_table(one)


def print_table(one: Mapping[str, Any]) -> None:
    """Print a table; columns beyond name, median and p99 are those that any row has."""
    extra = [key for line in one["rows"] for key in line if key not in ("name", "median", "p99", "count")]
    columns = ["median", "p99", *dict.fromkeys(extra)]
    width = max(len(one["title"]) + 5, *(len(line["name"]) for line in one["rows"])) + 2
    print(f"\n{one['title']} ({one['unit']})".ljust(width + 1) + "".join(f"{name:>14}" for name in columns))
    for line in one["rows"]:
        print(line["name"].ljust(width) + "".join(f"{_cell(line.get(name)):>14}" for name in columns))
    if one["facts"]:
        print(", ".join(f"{name}: {value}" for name, value in one["facts"].items()))
    print(f"waiting: {one['waiting']}")


def _cell(value: Any) -> str:
    if isinstance(value, float):
        return f"{value:.3f}" if value < 10 else f"{value:.1f}" if value < 1000 else f"{value:.0f}"
    return "" if value is None else str(value)
