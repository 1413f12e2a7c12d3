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
from collections.abc import Callable, Iterable, Mapping
from contextlib import ExitStack
from dataclasses import asdict, dataclass
from functools import partial
from typing import Any

from rosplc.errors import SetupError
from rosplc.shm import Description, Direction, Namespace, OwnedChannel
from rosplc_bench.compiling import compile_with_modbus
from rosplc_bench.figures import Cell, Figure, Series
from rosplc_bench.process import Side, free_port, python
from rosplc_bench.report import Page, Section, Table, median, percentile
from rosplc_bench.run import Context, Missing, need

NAMES = {
    "none": "no exchange (C)",
    "rosplc": "rosplc (C)",
    "semaphore": "shared memory and semaphore (C)",
    "plain": "shared memory without a lock (C)",
    "modbus-slave": "Modbus TCP, PLC is the server (C)",
    "modbus-master": "Modbus TCP, PLC asks in its task (C)",
    "rosplc-python": "rosplc (Python)",
    "opcua-python": "OPC UA (Python)",
}
"""Method → its name in tables."""

BYTES = 200


@dataclass(frozen=True)
class Method:
    """A running method; the other side stands still until it is told to go."""

    name: str
    task: Side
    peer: Side

    def stops_inside(self) -> bool:
        """Return whether the other side can be told to stand still in the middle of a message."""
        return not self.name.endswith("python") and self.name != "none"


class Starter:
    """Starts the methods that this machine has; their processes end with ``stack``."""

    def __init__(self, context: Context, stack: ExitStack) -> None:
        self._context, self._stack = context, stack
        programs, self._modbus = compile_with_modbus(context, "scan cycle", "scan_task", "scan_peer")
        self._programs = dict(zip(("task", "peer"), programs, strict=False))

    def methods(self) -> list[Method]:
        """Start all that are wanted."""
        context = self._context
        starters: dict[str, Callable[[], dict[str, Side]]] = {}
        if self._programs:
            starters["none"] = lambda: self._in_c("none")
            starters["rosplc"] = lambda: self._in_c("rosplc", *self._channels())
            for name in ("semaphore", "plain"):
                areas = str(context.scratch / f"areas-{secrets.token_hex(4)}")
                starters[name] = partial(self._in_c, name, areas)
            if self._modbus:
                for name in ("modbus-slave", "modbus-master"):
                    starters[name] = partial(self._over_modbus, name)
        if context.effort.name == "quick":
            context.skip(
                "scan cycle in Python, OPC UA among it", "left out of a quick run", "leave --quick out"
            )
        else:
            starters["rosplc-python"] = self._rosplc_python
            try:
                need("asyncua")
                starters["opcua-python"] = self._opcua_python
            except Missing as missing:
                context.skip("scan cycle over OPC UA", missing.reason, missing.remedy)
        found = []
        for name, starter in starters.items():
            if not context.wants(name):
                continue
            try:
                found.append(Method(name, **starter()))
            except SetupError as error:  # the others are measured
                context.fail(f"scan cycle, {NAMES[name]}", error.what)
        return found

    def hogs(self, stack: ExitStack) -> bool:
        """Let a program compute without end on each core until ``stack`` ends; False without a compiler."""
        for _ in os.sched_getaffinity(0) if self._programs else ():
            hog = stack.enter_context(Side("hog", [str(self._programs["peer"]), "hog"]))
            hog.receive_json()
        return bool(self._programs)

    def _run(self, name: str, command: list[str]) -> Side:
        return self._stack.enter_context(Side(name, command))

    def _run_c(self, role: str, method: str, *places: str) -> tuple[Side, str]:
        side = self._run(f"{method} {role}", [str(self._programs[role]), method, *places])
        return side, str(side.receive_json()["port"])

    def _in_c(self, method: str, *places: str) -> dict[str, Side]:
        peer, _ = self._run_c("peer", method, *reversed(places))
        task, _ = self._run_c("task", method, *places)
        return {"task": task, "peer": peer}

    def _over_modbus(self, method: str) -> dict[str, Side]:
        server, client = ("task", "peer") if method == "modbus-slave" else ("peer", "task")
        first, port = self._run_c(server, method)
        second, _ = self._run_c(client, method, port)
        return {server: first, client: second}

    def _in_python(self, role: str, method: str, plan: dict[str, Any]) -> Side:
        return self._run(f"{method} {role}", python("scan_cycle_python", role, method, json.dumps(plan)))

    def _channels(self) -> tuple[str, str]:
        context, stack = self._context, self._stack
        return _channel(context, stack, Direction.TO_PLC), _channel(context, stack, Direction.TO_ROS)

    def _rosplc_python(self) -> dict[str, Side]:
        to_plc, to_ros = self._channels()
        sides = {
            "task": self._in_python("task", "rosplc", {"out": to_ros, "in": to_plc}),
            "peer": self._in_python("peer", "rosplc", {"out": to_plc, "in": to_ros}),
        }
        for side in sides.values():
            side.receive_json()
        return sides

    def _opcua_python(self) -> dict[str, Side]:
        plan, sides = {"port": free_port()}, {}
        for role in ("task", "peer"):  # the server first
            sides[role] = self._in_python(role, "opcua", plan)
            sides[role].receive_json()
        return sides


def _channel(context: Context, stack: ExitStack, direction: Direction) -> str:
    namespace = Namespace(f"scan-{secrets.token_hex(4)}", str(context.scratch))
    topic = f"/scan/{'to_plc' if direction is Direction.TO_PLC else 'to_ros'}"
    about = Description(topic, "std_msgs/msg/Empty", "jazzy", direction, {}, "0" * 16, "bench", "uint8 x")
    channel = stack.enter_context(OwnedChannel.open(namespace, about, record_size=BYTES))
    return str(channel.path)


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
        for _ in range(rounds):
            for condition in conditions:
                with ExitStack() as beside:
                    if condition.hog and not starter.hogs(beside):
                        continue
                    for method in tuple(methods):
                        what = f"{condition.cycle_ms} ms, {NAMES[method.name]}"
                        context.notify(len(data["runs"]), total, what)
                        lowest = least if condition.hog or condition.fifo else quiet
                        scans = max(lowest, round(seconds * 1000 / condition.cycle_ms))
                        try:
                            data["runs"].append(measure(method, condition, scans))
                        except SetupError as error:  # the others are measured
                            context.fail(f"scan cycle, {NAMES[method.name]}", error.what)
                            methods.remove(method)
        data["stalls"] = [stall(method) for method in methods if method.stops_inside()]
    _check(context, data["runs"])
    return data if data["runs"] else {}


def measure(method: Method, condition: Condition, scans: int) -> dict[str, Any]:
    """Let a task run for some scans; return what it found, shortened."""
    cycle_ns = condition.cycle_ms * 1_000_000
    before, began = _cpu(method), time.monotonic()
    method.peer.ask(f"go {cycle_ns}")
    found = method.task.ask(f"run {cycle_ns} {scans} {FIFO if condition.fifo else 0}")
    method.peer.ask("halt")
    found["cpu"] = (_cpu(method) - before) / (time.monotonic() - began)
    for name in ("late_ns", "calls_ns", "ages_ns"):
        found[name] = summary(found[name])
    return {"method": method.name, **asdict(condition), "scans": scans, **found}


def _cpu(method: Method) -> float:
    return method.task.cpu_seconds() + method.peer.cpu_seconds()


def stall(method: Method, cycle_ns: int = 1_000_000, scans: int = 100) -> dict[str, Any]:
    """Stop the other side in the middle of a message; return the task's longest call."""
    method.peer.ask(f"go {cycle_ns}")
    method.task.send(f"run {cycle_ns} {scans} 0")
    time.sleep(scans * cycle_ns / 4e9)
    method.peer.ask(f"stall {STALL_NS}")
    found = method.task.receive_json()
    method.peer.ask("halt")
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
    p50, p99 = (round(percentile(values, percent)) for percent in (50, 99))
    return {"count": len(values), "p50": p50, "p99": p99, "max": max(values)}


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


_WAITING = (
    "the task sleeps until its next cycle, on an absolute grid; the other side sleeps between "
    "messages, which it sends at random moments, one to two cycles apart; a Modbus or OPC UA server "
    "sleeps until a request comes"
)
_BESIDE = {
    (False, False): "nothing beside it",
    (False, True): "nothing beside it, SCHED_FIFO",
    (True, False): "a hog on each core",
    (True, True): "a hog on each core, SCHED_FIFO",
}


def render(data: Mapping[str, Any]) -> Page:
    """Return the page; see :class:`rosplc_bench.report.Section`."""
    runs = [one for one in data["runs"] if one["scheduling"] != "refused"]
    methods = [name for name in NAMES if any(one["method"] == name for one in runs)]
    cycles = sorted({one["cycle_ms"] for one in runs})
    return Page(
        lead=_LEAD,
        tables=(
            _ages(runs, methods, cycles),
            _costs(runs, methods, cycles, "calls_ns", "Time that the method's calls take from a scan, µs"),
            _costs(runs, methods, cycles, "late_ns", "How late a scan begins, µs"),
            _whole(data, runs, methods),
        ),
        figures=_figures(runs, methods, cycles),
        after=_AFTER,
        summary=_summary(runs, data),
    )


def _values(
    runs: Iterable[Mapping[str, Any]],
    method: str,
    cycle: int,
    beside: tuple[bool, bool],
    what: str,
    part: str,
) -> list[float]:
    return [
        one[what][part] / 1000
        for one in runs
        if one["method"] == method
        and one["cycle_ms"] == cycle
        and (one["hog"], one["fifo"]) == beside
        and one[what]["count"]
    ]


def _ages(runs: list[Mapping[str, Any]], methods: list[str], cycles: list[int]) -> Table:
    rows: list[tuple[Cell, ...]] = []
    for method in methods:
        cells: list[Cell] = []
        for cycle in cycles:
            for part in ("p50", "p99"):
                found = median(_values(runs, method, cycle, (False, False), "ages_ns", part))
                cells.append(None if found is None else found / 1000)
        if any(cell is not None for cell in cells):
            rows.append((NAMES[method], *cells))
    header = ("cycle time", *(f"{cycle} ms: {part}" for cycle in cycles for part in ("median", "p99")))
    note = (
        "Age: from the moment of sending to the scan that first sees the message. Nothing beside the task. "
        "The median of the rounds' values; of fewer than 100 messages p99 is the largest."
    )
    return Table("Age of a message when the program first sees it, ms", header, tuple(rows), _WAITING, note)


def _costs(
    runs: list[Mapping[str, Any]], methods: list[str], cycles: list[int], what: str, title: str
) -> Table:
    shown = [cycle for cycle in cycles if cycle in (cycles[0], cycles[-1])]
    rows: list[tuple[Cell, ...]] = []
    for beside, words in _BESIDE.items():
        for method in methods:
            if what == "calls_ns" and method == "none":
                continue
            cells: list[Cell] = []
            for cycle in shown:
                cells.append(median(_values(runs, method, cycle, beside, what, "p50")))
                cells.append(median(_values(runs, method, cycle, beside, what, "p99")))
                cells.append(max(_values(runs, method, cycle, beside, what, "max"), default=None))
            if any(cell is not None for cell in cells):
                rows.append((words, NAMES[method], *cells))
    parts = ("median", "p99", "max")
    header = ("beside the task", "method", *(f"{cycle} ms: {part}" for cycle in shown for part in parts))
    note = (
        "Medians and p99: the median of the rounds'; max: of all rounds. Of fewer than 100 scans p99 "
        "is the largest."
    )
    return Table(title, header, tuple(rows), _WAITING, note)


def _whole(data: Mapping[str, Any], runs: list[Mapping[str, Any]], methods: list[str]) -> Table:
    stalls = {one["method"]: one for one in data["stalls"]}
    rows: list[tuple[Cell, ...]] = []
    for method in methods:
        mine = [one for one in runs if one["method"] == method]
        stalled = stalls.get(method)
        rows.append(
            (
                NAMES[method],
                sum(one["seen"] for one in mine) if method != "none" else None,
                sum(one["torn"] for one in mine) if method != "none" else None,
                sum(one["scans"] for one in mine),
                sum(one["missed"] for one in mine),
                _cpu_percent(mine),
                stalled["longest_ns"] / 1e6 if stalled else None,
                stalled["missed"] if stalled else None,
                stalled["torn"] if stalled else None,
            )
        )
    header = (
        "all conditions together",
        "messages seen",
        "torn",
        "scans",
        "scans missed",
        "CPU of both sides, %",
        "other side stopped: longest call, ms",
        "scans missed then",
        "messages torn then",
    )
    note = (
        "CPU: of a core, with nothing beside and the shortest cycle. Scans are also missed because of "
        "the machine, as the first row shows. In the last three columns the other side stops for "
        f"{data['stall_ms']:g} ms in the middle of a message, as a program does that is interrupted "
        "there; the task runs every 1 ms."
    )
    return Table("Messages and scans", header, tuple(rows), _WAITING, note)


def _cpu_percent(runs: list[Mapping[str, Any]]) -> float | None:
    quiet = [one for one in runs if not one["hog"] and not one["fifo"]]
    shortest = min((one["cycle_ms"] for one in quiet), default=0)
    found = [100 * one["cpu"] for one in quiet if one["cycle_ms"] == shortest]
    return median(found)


def _figures(runs: list[Mapping[str, Any]], methods: list[str], cycles: list[int]) -> tuple[Figure, ...]:
    ages: list[Series] = []
    costs: list[Series] = []
    for method in methods:
        for what, series, scale in (("ages_ns", ages, 1000), ("calls_ns", costs, 1)):
            points = [
                (float(cycle), found / scale)
                for cycle in cycles
                if (found := median(_values(runs, method, cycle, (False, False), what, "p50")))
            ]
            if points and not (what == "calls_ns" and method == "none"):
                x, y = zip(*points, strict=True)
                group = "rosplc" if method.startswith("rosplc") else ""
                series.append(Series(NAMES[method], x, y, group=group))
    return (
        Figure(
            "scan-cycle-age",
            "Age of a message at the first scan that sees it, median (sent at random moments)",
            "cycle time of the task, ms",
            "ms",
            tuple(ages),
        ),
        Figure(
            "scan-cycle-cost",
            "What the method's calls take from each scan, median",
            "cycle time of the task, ms",
            "µs",
            tuple(costs),
            y_log=True,
        ),
    )


def _summary(runs: list[Mapping[str, Any]], data: Mapping[str, Any]) -> tuple[str, ...]:
    lines = []
    cycle = max((one["cycle_ms"] for one in runs), default=0)
    for method in ("rosplc", "modbus-master"):
        age = median(_values(runs, method, cycle, (False, False), "ages_ns", "p50"))
        cost = median(_values(runs, method, cycle, (False, False), "calls_ns", "p50"))
        if age is not None and cost is not None:
            lines.append(
                f"A task of {cycle} ms sees a message {age / 1000:.1f} ms after it was sent over "
                f"{NAMES[method]}, and pays {cost:.1f} µs per scan."
            )
    for one in data["stalls"]:
        if one["method"] in ("rosplc", "semaphore", "plain"):
            lines.append(
                f"The other side stops for {data['stall_ms']:g} ms inside a message, "
                f"{NAMES[one['method']]}: longest call of the task {one['longest_ns'] / 1e6:.3g} ms, "
                f"torn messages {one['torn']}."
            )
    return tuple(lines)


_LEAD = (
    "A task reads one message of 200 bytes and writes another in each scan. In C the task is a loop "
    "that sleeps with clock_nanosleep, as soft-PLC runtimes on Linux do. With Modbus the PLC is either "
    "the server, whose thread fills registers that the program copies, or it asks in its task and "
    "waits for the answers. There is no OPC UA server in C here: that row is Python, and so is one of "
    "rosplc's, to compare it with. The semaphore is an unnamed one in the shared memory itself, which is "
    "what a named one maps too. A hog is a program that computes without end; one runs on each core.",
)

_AFTER = (
    "**What this means.** The age is about half a cycle with every method that keeps up: a message "
    "waits for the next scan, and the cycle, not the transport, decides how old it is. At 10 ms nobody "
    "gains anything there from a faster transport. What is left to win is in the other tables: the "
    "time that calls take from the cycle, and above all their longest time, because that is what a "
    "watchdog and a drive notice; whether a scan is missed because the other side stood still; whether "
    "a message is torn; and the CPU that stays for the rest.",
    "A call that waits for somebody else, for a lock or for an answer, takes as long as the other one "
    "takes. Most of the time that is little, which is why medians look harmless. rosplc's calls wait "
    "for nobody.",
    "**What it does not.** A general-purpose kernel on a shared or virtual machine has pauses of its "
    "own, which the row without any exchange shows; what lies below them cannot be seen here. A few "
    "seconds find no worst case. A PLC's own runtime, with its Modbus and OPC UA servers and their "
    "priorities, is not measured. Modbus with the PLC as the server copies registers while the "
    "server's thread may be filling them, which takes it a fraction of a microsecond: that no torn message "
    "was seen, where none was, is luck and not a promise. A client that stops tears nothing there, for a "
    "request that has not come whole is not carried out. The row without a lock is the control: the same "
    "memory and the same count, and a torn message in it when the other side stops inside one.",
)


SECTION = Section(
    name="scan-cycle",
    title="What a PLC's task sees and pays",
    question="How old is the data that a cyclic program sees, and what does each method add to its cycle?",
    run=run,
    render=render,
    contenders=tuple(NAMES),
)
