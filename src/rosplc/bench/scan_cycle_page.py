"""What people read of the scan-cycle view; made from its data alone."""

from __future__ import annotations

import statistics
from collections.abc import Iterable, Mapping
from typing import Any

from rosplc.bench.results import Cell, Figure, Page, Series, Table
from rosplc.bench.scan_cycle_methods import NAMES

__all__ = ["render"]

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
    """Return the page; see :class:`rosplc.bench.section.Section`."""
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


def _middle(values: list[float]) -> float | None:
    return statistics.median(values) if values else None


def _ages(runs: list[Mapping[str, Any]], methods: list[str], cycles: list[int]) -> Table:
    rows: list[tuple[Cell, ...]] = []
    for method in methods:
        cells: list[Cell] = []
        for cycle in cycles:
            for part in ("p50", "p99"):
                found = _middle(_values(runs, method, cycle, (False, False), "ages_ns", part))
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
                cells.append(_middle(_values(runs, method, cycle, beside, what, "p50")))
                cells.append(_middle(_values(runs, method, cycle, beside, what, "p99")))
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
                _cpu(mine),
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
        "other side stands still: longest call, ms",
        "scans missed then",
        "messages torn then",
    )
    note = (
        "CPU: of a core, with nothing beside and the shortest cycle. Scans are also missed because of "
        "the machine, as the first row shows. In the last three columns the other side stops for "
        f"{data['stall_ms']:g} ms in the middle of a message, as a program does that is interrupted "
        "there; the task runs every 1 ms."
    )
    return Table("What happens to messages and scans", header, tuple(rows), _WAITING, note)


def _cpu(runs: list[Mapping[str, Any]]) -> float | None:
    quiet = [one for one in runs if not one["hog"] and not one["fifo"]]
    shortest = min((one["cycle_ms"] for one in quiet), default=0)
    found = [100 * one["cpu"] for one in quiet if one["cycle_ms"] == shortest]
    return statistics.median(found) if found else None


def _figures(runs: list[Mapping[str, Any]], methods: list[str], cycles: list[int]) -> tuple[Figure, ...]:
    ages: list[Series] = []
    costs: list[Series] = []
    for method in methods:
        for what, series, scale in (("ages_ns", ages, 1000), ("calls_ns", costs, 1)):
            points = [
                (float(cycle), found / scale)
                for cycle in cycles
                if (found := _middle(_values(runs, method, cycle, (False, False), what, "p50")))
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
        age = _middle(_values(runs, method, cycle, (False, False), "ages_ns", "p50"))
        cost = _middle(_values(runs, method, cycle, (False, False), "calls_ns", "p50"))
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
