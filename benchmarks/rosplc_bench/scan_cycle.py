"""The scan-cycle view: what a PLC's task sees and pays, cycle time by cycle time.

One task runs at a time, with the other side sending at random moments; methods take turns within each
condition: alone, or beside a program on each core that computes without end; as an ordinary thread, or
with SCHED_FIFO as CODESYS runs its tasks.
"""

from __future__ import annotations

import json
import os
import secrets
import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import asdict, dataclass
from functools import partial
from typing import Any, NamedTuple

from rosplc.errors import SetupError
from rosplc.shm import Direction
from rosplc_bench.compiling import compile_with_modbus
from rosplc_bench.contenders import channels
from rosplc_bench.draw import Cell, Figure, Series
from rosplc_bench.process import Side, free_port, python
from rosplc_bench.report import Page, Section, Table, median, paragraphs, percentile, text
from rosplc_bench.run import Context, need

NAMES = {
    "none": "no exchange (C)",
    "rosplc": "rosplc (C)",
    "semaphore": "shared memory and semaphore (C)",
    "plain": "shared memory without a lock (C)",
    "modbus-slave": "Modbus TCP, PLC is the server (C)",
    "modbus-master": "Modbus TCP, PLC is the client (C)",
    "rosplc-python": "rosplc (Python)",
    "opcua-python": "OPC UA (Python)",
}
"""Method → its name in tables."""

BYTES = 200
FIFO = 63
"""Priority of an IEC task of priority 4: CODESYS runs 0 … 15 as 67 … 52."""
STALL_NS = 50_000_000


class Method(NamedTuple):
    """A running method; the other side does nothing until it is told to go."""

    name: str
    task: Side
    peer: Side

    def stops_inside(self) -> bool:
        """Return whether the other side can be told to stop in the middle of a message."""
        return not self.name.endswith("python") and self.name != "none"

    def cpu_seconds(self) -> float:
        """Return the processor time of both sides."""
        return self.task.cpu_seconds() + self.peer.cpu_seconds()


class Starter:
    """Starts the methods that this machine has; their processes end with ``stack``."""

    def __init__(self, context: Context, stack: ExitStack) -> None:
        self._context, self._stack = context, stack
        self._program, self._modbus = compile_with_modbus(context, "scan cycle", "scan")

    def methods(self) -> list[Method]:
        """Start all that are wanted."""
        context = self._context
        starters: dict[str, Callable[[], list[Side]]] = {}
        if self._program:
            areas = str(context.scratch / f"areas-{secrets.token_hex(4)}-")
            starters |= {
                "none": partial(self._in_c, "none"),
                "rosplc": lambda: self._in_c("rosplc", *self._channels()),
                "semaphore": partial(self._in_c, "semaphore", f"{areas}locked"),
                "plain": partial(self._in_c, "plain", f"{areas}plain"),
            }
        if self._program and self._modbus:
            starters |= {name: partial(self._over_modbus, name) for name in ("modbus-slave", "modbus-master")}
        if context.effort.name == "quick":
            what = "scan cycle in Python, including OPC UA"
            context.skip(what, "not part of a quick run", "run without --quick")
        else:
            starters["rosplc-python"] = self._rosplc_python
            with context.leaving_out("scan cycle over OPC UA"):
                need("asyncua")
                plan = {"port": free_port()}
                starters["opcua-python"] = partial(self._in_python, "opcua", {"task": plan, "peer": plan})
        found = []
        for name, starter in starters.items():
            with context.leaving_out(f"scan cycle, {NAMES[name]}"):
                if context.wants(name):
                    found.append(Method(name, *starter()))
        return found

    def hogs(self, stack: ExitStack) -> bool:
        """Let a program compute without end on each core until ``stack`` ends; False without a compiler."""
        for _ in os.sched_getaffinity(0) if self._program else ():
            hog = stack.enter_context(Side("hog", [str(self._program), "hog"]))
            hog.receive_json()
        return self._program is not None

    def _run(self, name: str, command: list[str]) -> tuple[Side, str]:
        side = self._stack.enter_context(Side(name, command))
        return side, str(side.receive_json()["port"])

    def _run_c(self, role: str, method: str, *places: str) -> tuple[Side, str]:
        return self._run(f"{method} {role}", [str(self._program), role, method, *places])

    def _in_c(self, method: str, *places: str) -> list[Side]:
        """Start both; ``places``: what the task writes, what it reads."""
        peer, _ = self._run_c("peer", method, *reversed(places))
        return [self._run_c("task", method, *places)[0], peer]

    def _over_modbus(self, method: str) -> list[Side]:
        server, client = ("task", "peer") if method == "modbus-slave" else ("peer", "task")
        first, port = self._run_c(server, method)
        second, _ = self._run_c(client, method, port)
        return [first, second] if server == "task" else [second, first]

    def _in_python(self, method: str, plans: Mapping[str, Mapping[str, Any]]) -> list[Side]:
        return [
            self._run(f"{method} {role}", python("scan_cycle_python", role, method, json.dumps(plan)))[0]
            for role, plan in plans.items()
        ]

    def _channels(self) -> tuple[str, str]:
        """Return the paths of the channel to ROS and the channel to the PLC."""
        place = self._context.scratch, 1, BYTES, self._stack
        to_ros, to_plc = (channels(*place, way)[0] for way in (Direction.TO_ROS, Direction.TO_PLC))
        return str(to_ros.path), str(to_plc.path)

    def _rosplc_python(self) -> list[Side]:
        to_ros, to_plc = self._channels()
        plans = {"task": {"out": to_ros, "in": to_plc}, "peer": {"out": to_plc, "in": to_ros}}
        return self._in_python("rosplc", plans)


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
    every, ends, both = (1, 2, 5, 10), (1, 10), (False, True)
    if effort == "full":
        return [Condition(ms, hog, fifo) for hog in both for fifo in both for ms in every]
    quiet = [Condition(ms) for ms in (ends if effort == "quick" else every)]
    return quiet + [Condition(ms, True, fifo) for fifo in both[effort == "quick" :] for ms in ends]


_EFFORTS = {"quick": (1, 0.05, 8, 10), "default": (2, 0.08, 10, 24), "full": (2, 0.5, 50, 60)}
"""Effort → rounds, seconds of a turn, scans at least, and where the age is looked at."""


def run(context: Context) -> dict[str, Any]:
    """Measure; see :class:`rosplc_bench.report.Section`."""
    rounds, seconds, least, quiet = _EFFORTS[context.effort.name]
    conditions = _conditions(context.effort.name)
    data: dict[str, Any] = {"runs": [], "stalls": [], "stall_ms": STALL_NS / 1e6}
    if not any(context.wants(name) for name in NAMES):
        return {}
    with ExitStack() as stack:
        starter = Starter(context, stack)
        methods = starter.methods()
        total = rounds * len(conditions) * len(methods)
        for condition in conditions * rounds:
            with ExitStack() as beside:
                if condition.hog and not starter.hogs(beside):
                    continue
                lowest = least if condition.hog or condition.fifo else quiet
                scans = max(lowest, round(seconds * 1000 / condition.cycle_ms))
                for method in tuple(methods):
                    name = NAMES[method.name]
                    context.notify(len(data["runs"]), total, f"{condition.cycle_ms} ms, {name}")
                    try:
                        data["runs"].append(measure(method, condition, scans))
                    except SetupError as error:  # the others are measured
                        context.fail(f"scan cycle, {name}", error.what)
                        methods.remove(method)
        data["stalls"] = [stall(method) for method in methods if method.stops_inside()]
    _check(context, data["runs"])
    return data if data["runs"] else {}


def measure(method: Method, condition: Condition, scans: int) -> dict[str, Any]:
    """Let a task run for some scans; return what it found, shortened."""
    cycle_ns = condition.cycle_ms * 1_000_000
    before, began = method.cpu_seconds(), time.monotonic()
    method.peer.ask(f"go {cycle_ns}")
    found = method.task.ask(f"run {cycle_ns} {scans} {FIFO if condition.fifo else 0}")
    method.peer.ask("halt")
    found["cpu"] = (method.cpu_seconds() - before) / (time.monotonic() - began)
    found |= {name: summary(found[name]) for name in ("late_ns", "calls_ns", "ages_ns")}
    return {"method": method.name, **asdict(condition), "scans": scans, **found}


def stall(method: Method, cycle_ns: int = 1_000_000, scans: int = 100) -> dict[str, Any]:
    """Stop the other side in the middle of a message; return the task's longest call."""
    method.peer.ask(f"go {cycle_ns}")
    method.task.send(f"run {cycle_ns} {scans} 0")
    time.sleep(scans * cycle_ns / 4e9)
    method.peer.ask(f"stall {STALL_NS}")
    found = method.task.receive_json()
    method.peer.ask("halt")
    longest = {"method": method.name, "longest_ns": max(found["calls_ns"])}
    return {**longest, "missed": found["missed"], "torn": found["torn"]}


def summary(values: list[int]) -> dict[str, int]:
    """Return what is kept of a list: median, p99, largest, and how many there were."""
    if not values:
        return {"count": 0}
    p50, p99 = (round(percentile(values, percent)) for percent in (50, 99))
    return {"count": len(values), "p50": p50, "p99": p99, "max": max(values)}


def _check(context: Context, runs: list[dict[str, Any]]) -> None:
    if any(one["scheduling"] == "refused" for one in runs):
        remedy = "run as root, or raise rtprio in /etc/security/limits.conf"
        context.skip("scan cycle with SCHED_FIFO", "this user is not permitted to use it", remedy)
    for method in ("rosplc", "rosplc-python"):
        if torn := sum(one["torn"] for one in runs if one["method"] == method):
            context.fail(f"scan cycle over {NAMES[method]}", f"{torn} torn messages")


_ALONE = (False, False)
_BESIDE = {
    _ALONE: "no other load",
    (False, True): "no other load, SCHED_FIFO",
    (True, False): "a hog on each core",
    (True, True): "a hog on each core, SCHED_FIFO",
}


class _Runs:
    """What was measured, without runs whose priority was refused."""

    def __init__(self, data: Mapping[str, Any]) -> None:
        self.all = [one for one in data["runs"] if one["scheduling"] != "refused"]
        self.methods = [name for name in NAMES if self.of(name)]
        self.paying = [name for name in self.methods if name != "none"]
        self.cycles = sorted({one["cycle_ms"] for one in self.all})

    def of(self, method: str) -> list[Mapping[str, Any]]:
        return [one for one in self.all if one["method"] == method]

    def values(
        self, method: str, cycle: int, what: str, part: str, beside: tuple[bool, bool] = _ALONE
    ) -> list[float]:
        """Return a part of each round's summary, in µs."""
        key = (cycle, *beside)
        return [
            one[what][part] / 1000
            for one in self.of(method)
            if (one["cycle_ms"], one["hog"], one["fifo"]) == key and one[what]["count"]
        ]

    def middle(
        self, method: str, cycle: int, what: str, part: str = "p50", beside: tuple[bool, bool] = _ALONE
    ) -> float | None:
        return median(self.values(method, cycle, what, part, beside))


def render(data: Mapping[str, Any]) -> Page:
    """Return the page; see :class:`rosplc_bench.report.Section`."""
    runs = _Runs(data)
    calls = "Time that the method's calls take in each scan, µs"
    return Page(
        lead=paragraphs("scan-cycle lead"),
        tables=(
            _ages(runs),
            _costs(runs, runs.paying, "calls_ns", calls),
            _costs(runs, runs.methods, "late_ns", "How late a scan begins, µs"),
            _whole(data, runs),
        ),
        figures=_figures(runs),
        after=paragraphs("scan-cycle after"),
        summary=_summary(runs, data),
    )


def _table(title: str, header: Sequence[str], rows: list[tuple[Cell, ...]], note: str) -> Table:
    return Table(title, tuple(header), tuple(rows), text("scan-cycle waiting"), note)


def _ages(runs: _Runs) -> Table:
    rows: list[tuple[Cell, ...]] = []
    for method in runs.methods:
        found = [
            runs.middle(method, cycle, "ages_ns", part) for cycle in runs.cycles for part in ("p50", "p99")
        ]
        if any(one is not None for one in found):
            rows.append((NAMES[method], *(None if one is None else one / 1000 for one in found)))
    header = ("cycle time", *(f"{cycle} ms: {part}" for cycle in runs.cycles for part in ("median", "p99")))
    return _table(
        "Age of a message when the program first sees it, ms", header, rows, text("scan-cycle ages")
    )


def _costs(runs: _Runs, methods: list[str], what: str, title: str) -> Table:
    shown = sorted({runs.cycles[0], runs.cycles[-1]})
    rows: list[tuple[Cell, ...]] = []
    for beside, words in _BESIDE.items():
        for method in methods:
            cells: list[Cell] = []
            for cycle in shown:
                cells += [runs.middle(method, cycle, what, part, beside) for part in ("p50", "p99")]
                cells.append(max(runs.values(method, cycle, what, "max", beside), default=None))
            if any(cell is not None for cell in cells):
                rows.append((words, NAMES[method], *cells))
    parts = [f"{cycle} ms: {part}" for cycle in shown for part in ("median", "p99", "max")]
    return _table(title, ("other load", "method", *parts), rows, text("scan-cycle costs"))


def _whole(data: Mapping[str, Any], runs: _Runs) -> Table:
    stalls = {one["method"]: one for one in data["stalls"]}
    rows: list[tuple[Cell, ...]] = []
    for method in runs.methods:
        mine, stalled = runs.of(method), stalls.get(method)
        total = {key: sum(one[key] for one in mine) for key in ("seen", "torn", "scans", "missed")}
        exchanged = (total["seen"], total["torn"]) if method != "none" else (None, None)
        then = (stalled["longest_ns"] / 1e6, stalled["missed"], stalled["torn"]) if stalled else (None,) * 3
        rows.append((NAMES[method], *exchanged, total["scans"], total["missed"], _cpu_percent(mine), *then))
    header = (
        "all conditions together",
        *("messages seen", "torn", "scans", "scans missed", "CPU of both sides, %"),
        *("other side stopped: longest call, ms", "scans missed", "messages torn"),
    )
    return _table("Messages and scans", header, rows, text("scan-cycle whole", stall=data["stall_ms"]))


def _cpu_percent(runs: list[Mapping[str, Any]]) -> float | None:
    quiet = [one for one in runs if not one["hog"] and not one["fifo"]]
    shortest = min((one["cycle_ms"] for one in quiet), default=0)
    return median(100 * one["cpu"] for one in quiet if one["cycle_ms"] == shortest)


def _series(runs: _Runs, methods: list[str], what: str, scale: int) -> tuple[Series, ...]:
    lines = []
    for method in methods:
        found = {cycle: runs.middle(method, cycle, what) for cycle in runs.cycles}
        points = {float(cycle): value / scale for cycle, value in found.items() if value}
        if points:
            group = "rosplc" if method.startswith("rosplc") else ""
            lines.append(Series(NAMES[method], tuple(points), tuple(points.values()), group))
    return tuple(lines)


def _figures(runs: _Runs) -> tuple[Figure, ...]:
    ages, costs = _series(runs, runs.methods, "ages_ns", 1000), _series(runs, runs.paying, "calls_ns", 1)
    age = "Median age of a message when a scan first sees it (sent at random times)"
    cost = "Median time that the method's calls take in each scan"
    cycle = "cycle time of the task, ms"
    return (
        Figure("scan-cycle-age", age, cycle, "ms", ages),
        Figure("scan-cycle-cost", cost, cycle, "µs", costs, y_log=True),
    )


def _summary(runs: _Runs, data: Mapping[str, Any]) -> tuple[str, ...]:
    lines = []
    cycle = max(runs.cycles, default=0)
    for method in ("rosplc", "modbus-master"):
        age, cost = (runs.middle(method, cycle, what) for what in ("ages_ns", "calls_ns"))
        if age is not None and cost is not None:
            lines.append(
                f"A task of {cycle} ms sees a message {age / 1000:.1f} ms after it was sent over "
                f"{NAMES[method]}, at a cost of {cost:.1f} µs per scan."
            )
    for one in data["stalls"]:
        if one["method"] in ("rosplc", "semaphore", "plain"):
            lines.append(
                f"If the other side stops for {data['stall_ms']:g} ms inside a message, over "
                f"{NAMES[one['method']]}, the task's longest call takes {one['longest_ns'] / 1e6:.3g} ms, "
                f"and {one['torn']} messages are torn."
            )
    return tuple(lines)


SECTION = Section(
    name="scan-cycle",
    title="What a PLC's task sees and pays",
    question="How old is the data that a cyclic program sees, and how much of its cycle does a method use?",
    run=run,
    render=render,
    contenders=tuple(NAMES),
)
