"""What all measurements share: the machine's description, taking turns, statistics, tables.

A benchmark has ``run(rounds)``, which returns a :func:`report`, and a ``main()`` that calls
:func:`main`. Contenders take turns in every round, so that a slow moment of the machine hits them
alike, and what is compared are ratios within one run. Nothing here asserts a time.
"""

from __future__ import annotations

import argparse
import json
import os
import platform
import statistics
import subprocess
import sys
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from datetime import datetime, timezone
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

__all__ = ["environment", "main", "mean_ns", "median_ratio", "percentile", "report", "row", "table", "turns"]

PACKAGES = ("rosplc", "cyclonedds", "rosbags")


def environment() -> dict[str, Any]:
    """Return machine, kernel, versions and load, as they are now."""
    return {
        "when": datetime.now(timezone.utc).isoformat(timespec="seconds"),
        "processor": _processor(),
        "cores": os.cpu_count(),
        "virtual": " hypervisor " in _read("/proc/cpuinfo"),
        "kernel": f"{platform.system()} {platform.release()}",
        "python": platform.python_version(),
        "compiler": _first_line("gcc", "--version"),
        "versions": {name: _version(name) for name in PACKAGES},
        "load_average": [round(value, 2) for value in os.getloadavg()],
    }


def _read(path: str) -> str:
    try:
        return Path(path).read_text()
    except OSError:
        return ""


def _processor() -> str:
    for line in _read("/proc/cpuinfo").splitlines():
        if line.startswith(("model name", "Model")):
            return line.partition(":")[2].strip()
    return platform.machine()


def _first_line(*command: str) -> str:
    try:
        return subprocess.run(command, capture_output=True, text=True, check=True).stdout.splitlines()[0]
    except (OSError, subprocess.CalledProcessError, IndexError):
        return "none"


def _version(name: str) -> str:
    try:
        return version(name)
    except PackageNotFoundError:
        return "none"


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


def percentile(values: Sequence[float], percent: float) -> float:
    """Return the value that ``percent`` of the values do not exceed."""
    return sorted(values)[min(len(values) - 1, int(len(values) * percent / 100))]


def median_ratio(these: Sequence[float], those: Sequence[float]) -> float:
    """Return the median of the ratios of values taken in the same turn."""
    return statistics.median(a / b for a, b in zip(these, those, strict=True))


def row(name: str, values: Sequence[float], **more: Any) -> dict[str, Any]:
    """Return a table's row: median, 99th percentile, number of values, and ``more``."""
    return {
        "name": name,
        "median": statistics.median(values),
        "p99": percentile(values, 99),
        "count": len(values),
        **more,
    }


def table(
    title: str, unit: str, waiting: str, rows: list[dict[str, Any]], facts: Mapping[str, Any] | None = None
) -> dict[str, Any]:
    """Return a table; ``waiting`` says how whoever waits in it does so, ``facts`` what else was found."""
    return {"title": title, "unit": unit, "waiting": waiting, "rows": rows, "facts": dict(facts or {})}


def report(tables: list[dict[str, Any]], before: Mapping[str, Any]) -> dict[str, Any]:
    """Return a benchmark's result: its tables, and the machine before and after."""
    after = [round(value, 2) for value in os.getloadavg()]
    return {"environment": {**before, "load_average_after": after}, "tables": tables}


def main(run: Callable[[int], dict[str, Any]], doc: str | None, rounds: int) -> None:
    """Parse the command line, run, and print tables or JSON."""
    parser = argparse.ArgumentParser(description=(doc or "").partition("\n")[0])
    parser.add_argument("--rounds", type=int, default=rounds, help=f"default: {rounds}")
    parser.add_argument("--json", action="store_true", help="print everything as JSON")
    arguments = parser.parse_args()
    result = run(arguments.rounds)
    if arguments.json:
        json.dump(result, sys.stdout, indent=2)
        print()
        return
    print_environment(result["environment"])
    for one in result["tables"]:
        print_table(one)


def print_environment(facts: Mapping[str, Any]) -> None:
    """Print the machine in three lines."""
    kind = "virtual machine" if facts["virtual"] else "machine"
    print(f"{facts['when']}  {facts['processor']}, {facts['cores']} cores, {kind}, {facts['kernel']}")
    versions = ", ".join(f"{name} {number}" for name, number in facts["versions"].items())
    print(f"Python {facts['python']}, {versions}, {facts['compiler']}")
    print(f"load average {facts['load_average']} before, {facts['load_average_after']} after")


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
    if value is None:
        return ""
    if isinstance(value, float):
        return f"{value:.3f}" if value < 10 else f"{value:.1f}" if value < 1000 else f"{value:.0f}"
    return str(value)
