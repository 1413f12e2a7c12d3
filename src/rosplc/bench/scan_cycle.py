"""The scan-cycle view: what a PLC's task sees and pays, cycle time by cycle time.

One task runs at a time, with the other side sending at random moments; methods take turns within each
condition. Beside it nothing, or a program on each core that computes without end; as an ordinary thread, or
with SCHED_FIFO as CODESYS runs its tasks.
"""

from __future__ import annotations

import os
import time
from contextlib import ExitStack
from dataclasses import asdict, dataclass
from typing import Any

from rosplc.bench.context import Context
from rosplc.bench.end_to_end_child import WATCHDOG_S
from rosplc.bench.percentiles import percentile
from rosplc.bench.process import Side
from rosplc.bench.scan_cycle_methods import NAMES, Method, Programs, start
from rosplc.bench.scan_cycle_page import render
from rosplc.bench.section import Section
from rosplc.errors import SetupError

__all__ = ["SECTION", "Condition", "run", "summary"]

FIFO = 63
"""Priority of an IEC task of priority 4: CODESYS runs 0 … 15 as 67 … 52."""
STALL_NS = 50_000_000


@dataclass(frozen=True)
class Condition:
    """What a task runs under.

    Attributes:
        cycle_ms: Its period.
        hog: Whether programs that compute without end use every core.
        fifo: Whether it asks for SCHED_FIFO.
    """

    cycle_ms: int
    hog: bool = False
    fifo: bool = False


def _conditions(effort: str) -> list[Condition]:
    if effort == "full":
        return [
            Condition(ms, hog, fifo)
            for hog in (False, True)
            for fifo in (False, True)
            for ms in (1, 2, 5, 10)
        ]
    quiet = [Condition(ms) for ms in ((1, 10) if effort == "quick" else (1, 2, 5, 10))]
    loaded = [Condition(ms, True, fifo) for fifo in (False, True) for ms in (1, 10)]
    return quiet + (loaded[2:] if effort == "quick" else loaded)


_EFFORTS = {"quick": (1, 0.05, 8, 10), "default": (2, 0.08, 10, 24), "full": (2, 0.5, 50, 60)}
"""Effort → rounds, seconds of a turn, scans at least, and where the age is looked at."""


def run(context: Context) -> dict[str, Any]:
    """Measure; see :class:`rosplc.bench.section.Section`."""
    rounds, seconds, least, quiet = _EFFORTS[context.effort.name]
    conditions = _conditions(context.effort.name)
    data: dict[str, Any] = {"runs": [], "stalls": [], "stall_ms": STALL_NS / 1e6}
    if not any(context.wants(name) for name in NAMES):
        return {}
    with ExitStack() as stack:
        programs = Programs.compiled(context)
        methods = start(context, programs, stack)
        total = rounds * len(conditions) * len(methods)
        for _ in range(rounds):
            for condition in conditions:
                with ExitStack() as beside:
                    if condition.hog and not _hogs(context, programs, beside):
                        continue
                    for method in tuple(methods):
                        what = f"{condition.cycle_ms} ms, {NAMES[method.name]}"
                        context.notify(len(data["runs"]), total, what)
                        lowest = least if condition.hog or condition.fifo else quiet
                        scans = max(lowest, round(seconds * 1000 / condition.cycle_ms))
                        try:
                            data["runs"].append(measure(method, condition, scans))
                        except SetupError as error:  # the others go on
                            context.fail(f"scan cycle, {NAMES[method.name]}", error.what)
                            methods.remove(method)
        data["stalls"] = [stall(method) for method in methods if method.stops_inside()]
    _check(context, data["runs"])
    return data if data["runs"] else {}


def measure(method: Method, condition: Condition, scans: int) -> dict[str, Any]:
    """Let a task run for some scans; return what it found, shortened."""
    cycle_ns = condition.cycle_ms * 1_000_000
    before, began = _cpu(method), time.monotonic()
    _ask(method.peer, f"go {cycle_ns}")
    found = _ask(method.task, f"run {cycle_ns} {scans} {FIFO if condition.fifo else 0}")
    _ask(method.peer, "halt")
    found["cpu"] = (_cpu(method) - before) / (time.monotonic() - began)
    for name in ("late_ns", "calls_ns", "ages_ns"):
        found[name] = summary(found[name])
    return {"method": method.name, **asdict(condition), "scans": scans, **found}


def _cpu(method: Method) -> float:
    return method.task.cpu_seconds() + method.peer.cpu_seconds()


def stall(method: Method, cycle_ns: int = 1_000_000, scans: int = 100) -> dict[str, Any]:
    """Let the other side stand still in the middle of a message; return the task's longest call."""
    _ask(method.peer, f"go {cycle_ns}")
    method.task.order(f"run {cycle_ns} {scans} 0")
    time.sleep(scans * cycle_ns / 4e9)
    _ask(method.peer, f"stall {STALL_NS}")
    found = method.task.hear_json(WATCHDOG_S)
    _ask(method.peer, "halt")
    return {
        "method": method.name,
        "longest_ns": max(found["calls_ns"]),
        "missed": found["missed"],
        "torn": found["torn"],
    }


def summary(values: list[int]) -> dict[str, int]:
    """Return what is kept of a list: median, p99, largest, and how many there were."""
    if not values:
        return {"count": 0}
    ordered = sorted(values)
    return {
        "count": len(ordered),
        "p50": round(percentile(ordered, 50)),
        "p99": round(percentile(ordered, 99)),
        "max": ordered[-1],
    }


def _ask(side: Side, order: str) -> Any:
    side.order(order)
    return side.hear_json(WATCHDOG_S)


def _hogs(context: Context, programs: Programs | None, stack: ExitStack) -> bool:
    if programs is None:
        return False
    for _ in os.sched_getaffinity(0):
        hog = Side("hog", [str(programs.peer), "hog"])
        stack.callback(hog.close)
        hog.hear_json(WATCHDOG_S)
    return True


def _check(context: Context, runs: list[dict[str, Any]]) -> None:
    if any(one["scheduling"] == "refused" for one in runs):
        context.skip(
            "scan cycle with SCHED_FIFO",
            "this user may not use it",
            "run as root, or raise rtprio in /etc/security/limits.conf",
        )
    for method in ("rosplc", "rosplc-python"):
        if torn := sum(one["torn"] for one in runs if one["method"] == method):
            context.fail(f"scan cycle over {NAMES[method]}", f"{torn} torn messages")


SECTION = Section(
    name="scan-cycle",
    title="What a PLC's task sees and pays",
    question="How old is the data that a cyclic program sees, and what does each method add to its cycle?",
    run=run,
    render=render,
    contenders=tuple(NAMES),
)
