"""What people read of the end-to-end comparison; made from its data alone."""

from __future__ import annotations

import statistics
from collections.abc import Mapping
from typing import Any

from rosplc.bench.percentiles import percentile
from rosplc.bench.results import Cell, Figure, Page, Series, Table

__all__ = ["render"]

_NAMES = {"rosplc": "rosplc", "modbus": "Modbus TCP (pymodbus)", "opcua": "OPC UA (asyncua)"}


def render(data: Mapping[str, Any]) -> Page:
    """Return the page; see :class:`rosplc.bench.section.Section`."""
    cycles = sorted({one["cycle_ms"] for one in data["rounds"]})
    tables: list[Table] = []
    for cycle in cycles:
        rows = _rows(data, cycle)
        tables += [_times(data, rows, cycle), _losses(rows, cycle)]
    rows = _rows(data, cycles[0])
    return Page(
        lead=_lead(data),
        tables=tuple(tables),
        figures=_figures(rows, cycles[0]),
        after=_AFTER,
        summary=tuple(_summary(rows)),
    )


def _rows(data: Mapping[str, Any], cycle: float) -> list[_Row]:
    rows = [_Row(data, cycle, kind, method) for kind in data["kinds"] for method in _NAMES]
    return [row for row in rows if row.turns]


def _waiting(cycle: float) -> str:
    return (
        f"the PLC's task runs every {cycle:g} ms; a hand-written bridge sleeps until a message arrives, "
        "and reads the PLC's side every 1 ms or as fast as the answers come; rosplc's sleeps on DDS "
        "towards the PLC and looks every 1 ms towards ROS; the ROS process sleeps until a message "
        "arrives"
    )


class _Row:
    """One type over one method, all rounds together."""

    def __init__(self, data: Mapping[str, Any], cycle: float, kind: str, method: str) -> None:
        self.kind, self.method, self.facts = kind, method, data["kinds"][kind]
        key = (cycle, kind, method)
        self.turns = [one for one in data["rounds"] if (one["cycle_ms"], one["kind"], one["method"]) == key]
        self.latencies = [value for one in self.turns for value in one["stream"]["latencies_us"]]
        parts = [one[part] for one in self.turns for part in ("stream", "ping")]
        self.sent = sum(part["sent"] for part in parts)
        self.back = sum(len(part["latencies_us"]) for part in parts)
        self.received = sum(part["received"] for part in parts)
        self.torn_ros = sum(part["torn"] for part in parts)
        self.seen = sum(one["ping"]["plc"]["seen"] for one in self.turns)
        self.torn_plc = sum(one["ping"]["plc"]["torn"] for one in self.turns)
        whole = [part for part in parts if part["latencies_us"]]
        self.error = max((part["error"] for part in whole), default=None)
        self.strings = min((part["strings"] for part in whole), default=None)

    @property
    def name(self) -> str:
        return f"{self.kind} over {_NAMES[self.method]}"

    def medians(self) -> list[float]:
        """Return each round's median latency in µs, in the order of rounds; inf for none."""
        return [
            statistics.median(one["stream"]["latencies_us"])
            if one["stream"]["latencies_us"]
            else float("inf")
            for one in self.turns
        ]

    def rate(self) -> float | None:
        rates = [
            len(one["ping"]["latencies_us"]) / one["ping"]["seconds"]
            for one in self.turns
            if one["ping"]["seconds"]
        ]
        return statistics.median(rates) if rates else None

    def cpu(self, which: int) -> float:
        return 100 * float(statistics.median(one["stream"]["cpu"][which] for one in self.turns))

    def carried(self) -> str:
        """Say what of the message's structure the PLC's program meets."""
        if self.method == "rosplc":
            return "1 struct of the type"
        if self.method == "modbus":
            return f"{self.facts['registers']} registers without names or types"
        return f"{self.facts['leaves']} nodes with names"


def _lead(data: Mapping[str, Any]) -> tuple[str, ...]:
    return (
        "An ordinary DDS participant sends messages as ROS 2 does; a bridge puts them into the PLC; "
        "the PLC's program copies what it sees back; the participant judges what comes. Everything in "
        "a message follows from its number, so pieces of two messages in one (torn), a missing string "
        "and a rounded number are found by looking, at the PLC and at the end.",
        "Modbus: two registers per number, 123 or 125 per request, a server beside the PLC's task, a "
        "client in the bridge. OPC UA: one node per field, an array being one node, as a PLC's symbol "
        "configuration has it; the client writes and reads all nodes of a message in one request. All "
        "PLC programs are Python; the task may interrupt the server anywhere, as a task of higher "
        "priority does (the interpreter may switch between the two every 50 µs). The same code counts "
        "torn messages for all three ways.",
        f"Each way carries messages at {data['rate_hz']:g} per second first, with random gaps, then as "
        "many as come back, one under way at a time.",
    )


def _times(data: Mapping[str, Any], rows: list[_Row], cycle: float) -> Table:
    reference = {row.kind: row.medians() for row in rows if row.method == "rosplc"}
    lines: list[tuple[Cell, ...]] = []
    for row in rows:
        found = sorted(row.latencies)
        ratios = [
            one / other
            for one, other in zip(row.medians(), reference.get(row.kind, []), strict=False)
            if float("inf") not in (one, other)
        ]
        lines.append(
            (
                row.name,
                statistics.median(found) if found else None,
                percentile(found, 99) if found else None,
                found[-1] if found else None,
                statistics.median(ratios) if ratios else None,
                row.rate(),
                row.cpu(0),
                row.cpu(1),
            )
        )
    header = (
        "there and back",
        "median µs",
        "p99 µs",
        "max µs",
        "÷ rosplc",
        "round trips/s",
        "bridge CPU %",
        "PLC CPU %",
    )
    note = (
        f"Times and CPU (of a core) at {data['rate_hz']:g} messages per second; round trips per second "
        "with one message under way. A bridge's CPU includes looking while nothing happens. Of fewer "
        "than 100 messages p99 is the largest. Ratios are medians of the rounds' ratios."
    )
    title = f"There and back, with a PLC task of {cycle:g} ms"
    return Table(title, header, tuple(lines), _waiting(cycle), note)


def _losses(rows: list[_Row], cycle: float) -> Table:
    lines: list[tuple[Cell, ...]] = []
    for row in rows:
        strings = row.facts["strings"]
        lines.append(
            (
                row.name,
                row.carried(),
                "–" if not strings else f"{row.strings} of {strings}" if row.strings is not None else "?",
                "?" if row.error is None else "exact" if row.error == 0 else f"off by up to {row.error:.0e}",
                row.sent,
                row.sent - row.back,
                f"{row.torn_plc:,} of {row.seen:,}",
                f"{row.torn_ros:,} of {row.received:,}",
            )
        )
    header = (
        "what is lost",
        "structure on the PLC's side",
        "strings kept",
        "64-bit numbers",
        "sent",
        "not back whole",
        "torn at the PLC",
        "torn back in ROS",
    )
    note = (
        "Numbers: the largest deviation, relative to the value. Not back: replaced by a newer one on the way."
    )
    title = f"What is lost on the way, with a PLC task of {cycle:g} ms"
    return Table(title, header, tuple(lines), _waiting(cycle), note)


def _figures(rows: list[_Row], cycle: float) -> tuple[Figure, ...]:
    times = tuple(
        Series(row.name, (), (statistics.median(row.latencies) / 1000,), group=row.method)
        for row in rows
        if row.latencies
    )
    torn = tuple(
        Series(row.name, (), (100 * row.torn_plc / row.seen,), group=row.method) for row in rows if row.seen
    )
    task = f"PLC task every {cycle:g} ms"
    return (
        Figure("end-to-end", f"ROS 2 to the PLC and back, median ({task})", "", "ms", times, kind="bars"),
        Figure(
            "end-to-end-torn",
            f"Torn messages that the PLC's program saw ({task})",
            "",
            "% of the messages seen",
            torn,
            kind="bars",
        ),
    )


def _summary(rows: list[_Row]) -> list[str]:
    lines = []
    for method in dict.fromkeys(row.method for row in rows):
        mine = [row for row in rows if row.method == method]
        found = [value for row in mine for value in row.latencies]
        if found:
            torn, seen = sum(row.torn_plc for row in mine), sum(row.seen for row in mine)
            lines.append(
                f"ROS 2 to the PLC and back over {_NAMES[method]}: median "
                f"{statistics.median(found) / 1000:.1f} ms, {torn} of {seen} messages torn at the PLC."
            )
    return lines


_AFTER = (
    "**What this means.** A large part of every round trip is waiting for the next scan and for the "
    "next look of the bridge, whatever carries the message; with a slower task the cycle decides, not "
    "the transport. The rest is the work and the wake-ups of all processes on the way: a busy machine "
    "stretches that, the more the more requests a message needs. At 10 ms a message may be replaced by "
    "a newer one before a scan has seen it, with every way that keeps only the newest. What differs "
    "most is what arrives. Registers have no strings, no names and no 64-bit numbers, and a message of "
    "more than 123 registers is written in several requests: a scan between two of them sees half of "
    "each. OPC UA keeps numbers and strings, but a Write of several nodes is not one step for a task "
    "that runs beside the server.",
    "**What it does not.** The servers are pymodbus and asyncua in Python, not a PLC's own; how often "
    "a torn message is seen depends on how long a server takes between two pieces and on the task's "
    "period. That it can be seen does not: neither protocol promises more. A Modbus message that fits "
    "into one request arrives whole here because this server stores a request in one step; the "
    "protocol does not say so. A user can add a counter at both ends and throw torn messages away; "
    "then they are lost instead of torn, and somebody has to write and test that for each type. The "
    "mappings are the usual ones, not the only ones: four registers can carry a 64-bit number and further "
    "ones a string, where both ends agree on it, at the price of more requests; an OPC UA structure can "
    "carry a whole message in one node, where server and client know its type.",
)
