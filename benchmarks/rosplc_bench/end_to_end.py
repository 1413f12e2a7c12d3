"""The end-to-end comparison: ROS 2 message → PLC variable and back, over three ways.

One ROS process sends by turns over rosplc, over Modbus TCP registers and over OPC UA nodes; each way has a
bridge process and a PLC process of its own, all of which live through the whole run. What a way loses is
computed from what came back: :mod:`rosplc_bench.end_to_end_sides` makes messages that tell.
"""

from __future__ import annotations

import json
import secrets
import statistics
import time
from collections.abc import Mapping
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from rosplc.demo.domain import FreeDomain
from rosplc.errors import SetupError
from rosplc_bench.end_to_end_sides import DISTRO, KINDS, LIMITS, register_count, topics
from rosplc_bench.figures import Cell, Figure, Series
from rosplc_bench.process import Side, free_port, python
from rosplc_bench.report import Page, Section, Table, percentile
from rosplc_bench.run import Context, Missing, need

RATE_HZ = 100.0
_FIND_S = 60.0


@dataclass(frozen=True)
class Amount:
    """How much is measured.

    Attributes:
        cycles_ms: Periods of the PLC's task.
        rounds: How often all take turns, for each period.
        messages: Messages of a stream.
        seconds: How long messages go one at a time.
    """

    cycles_ms: tuple[float, ...]
    rounds: int
    messages: int
    seconds: float


_AMOUNTS = {
    "quick": Amount((1.0,), 1, 10, 0.1),
    "default": Amount((1.0,), 2, 25, 0.2),
    "full": Amount((1.0, 10.0), 3, 120, 0.8),
}
"""By effort."""


def run(context: Context) -> dict[str, Any]:
    """Measure; see :class:`rosplc_bench.report.Section`."""
    amount = _AMOUNTS[context.effort.name]
    methods = _methods(context)
    if not methods:
        return {}
    data: dict[str, Any] = {
        "rate_hz": RATE_HZ,
        "rounds": [],
        "kinds": {
            name: {"strings": kind.strings(), "leaves": len(kind.paths), "registers": register_count(kind)}
            for name, kind in KINDS.items()
        },
    }
    total = len(amount.cycles_ms) * amount.rounds * len(methods) * len(KINDS)
    for cycle_ms in amount.cycles_ms:
        with ExitStack() as stack:
            comparison = Comparison(context, methods, cycle_ms, stack)
            for number in range(amount.rounds):
                for kind in KINDS:
                    for method in tuple(comparison.methods):
                        what = f"{kind} over {method}, round {number + 1}"
                        context.notify(len(data["rounds"]), total, what)
                        try:
                            data["rounds"].append(comparison.measure(method, kind, amount))
                        except SetupError as error:  # the others are measured
                            context.fail(f"{kind} over {method}", error.what)
                            comparison.methods.remove(method)
    _check(context, data["rounds"])
    return data if data["rounds"] else {}


def _check(context: Context, rounds: list[dict[str, Any]]) -> None:
    """Fail the run if rosplc did not do what it promises; nothing is demanded of the others."""
    for one in rounds:
        if one["method"] != "rosplc":
            continue
        what = f"{one['kind']} over rosplc"
        parts = (one["stream"], one["ping"])
        if torn := one["ping"]["plc"]["torn"] + sum(part["torn"] for part in parts):
            context.fail(what, f"{torn} torn messages")
        if not any(part["latencies_us"] for part in parts):
            context.fail(what, f"none of {sum(part['sent'] for part in parts)} messages came back")
        for part in parts:
            if part["latencies_us"] and (part["error"] or part["strings"] < KINDS[one["kind"]].strings()):
                context.fail(what, "what came back is not what was sent")


def _methods(context: Context) -> list[str]:
    found = []
    for method, package in (("rosplc", "cyclonedds"), ("modbus", "pymodbus"), ("opcua", "asyncua")):
        if not context.wants(method):
            continue
        try:
            need("cyclonedds")
            need(package)
            found.append(method)
        except Missing as missing:
            context.skip(f"end to end over {method}", missing.reason, missing.remedy)
    return found


class Comparison:
    """All processes of the comparison; they end with ``stack``.

    Attributes:
        methods: Those that run.
    """

    def __init__(self, context: Context, methods: list[str], cycle_ms: float, stack: ExitStack) -> None:
        self.methods = list(methods)
        self._cycle_ms = cycle_ms
        domain = FreeDomain()
        stack.callback(domain.close)
        prefix = f"e2e-{secrets.token_hex(4)}"
        configuration = context.scratch / f"{prefix}.json"
        configuration.write_text(json.dumps(_configuration(prefix, context.scratch, domain.number)))
        common = {"domain": domain.number, "configuration": str(configuration)}
        self._plcs: dict[str, Side] = {}
        self._bridges: dict[str, Side] = {}

        def start(role: str, plan: dict[str, Any], method: str = "") -> Side:
            command = _local(domain.number, role, json.dumps(plan), method)
            return stack.enter_context(Side(f"{method} {role}".strip(), command))

        plan = {"domain": domain.number, "methods": methods, "kinds": list(KINDS)}
        self._ros = start("ros", plan)
        places: dict[str, Any] = {}
        if "rosplc" in methods:  # objects before the PLC looks for them
            self._bridges["rosplc"] = start("bridge", common, "rosplc")
        for method in methods:
            places[method] = [prefix, str(context.scratch)] if method == "rosplc" else free_port()
            plan = {"cycle": cycle_ms / 1000, "where": places[method]}
            self._plcs[method] = start("plc", plan, method)
        self._ready(context, self._plcs)
        for method in self.methods:
            if method != "rosplc":
                self._bridges[method] = start("bridge", {**common, "where": places[method]}, method)
        self._ros.receive_json()
        self._ready(context, self._bridges)
        self._find_each_other()
        for kind in KINDS:  # everything has run once before anything counts
            for method in self.methods:
                self._begin(method, kind)
                self._ros.ask(do="ping", method=method, kind=kind, seconds=0.05)

    def _ready(self, context: Context, sides: Mapping[str, Side]) -> None:
        """Wait until they are up; what does not start is left out, and the others continue."""
        for method in tuple(self.methods):
            try:
                sides[method].receive_json()
            except SetupError as error:
                context.fail(f"end to end over {method}", error.what)
                self.methods.remove(method)

    def _find_each_other(self) -> None:
        end = time.monotonic() + _FIND_S
        while missing := [
            line for line in self._ros.ask(do="ready")["missing"] if line.split()[0] in self.methods
        ]:
            if time.monotonic() > end:
                raise SetupError("SYS004", f"the ROS process finds no bridge for {', '.join(missing)}")
            time.sleep(0.05)

    def _begin(self, method: str, kind: str) -> None:
        self._plcs[method].ask(kind=kind)
        self._bridges[method].ask(kind=kind)

    def measure(self, method: str, kind: str, amount: Amount) -> dict[str, Any]:
        """Measure one turn: a stream, then a ping-pong."""
        self._begin(method, kind)
        bridge, plc = self._bridges[method], self._plcs[method]
        before = [side.cpu_seconds() for side in (bridge, plc)]
        stream = self._ros.ask(do="stream", method=method, kind=kind, count=amount.messages, rate=RATE_HZ)
        after = [side.cpu_seconds() for side in (bridge, plc)]
        stream["cpu"] = [(b - a) / stream["seconds"] for a, b in zip(before, after, strict=True)]
        stream["plc"] = plc.ask(report=True)
        ping = self._ros.ask(do="ping", method=method, kind=kind, seconds=amount.seconds)
        ping["plc"] = plc.ask(report=True)
        return {
            "cycle_ms": self._cycle_ms,
            "method": method,
            "kind": kind,
            "stream": stream,
            "ping": ping,
        }


def _local(domain: int, *arguments: str) -> list[str]:
    """Return the command line of a process whose ROS stays on this machine."""
    return python(
        "end_to_end_sides",
        *arguments,
        without=("CYCLONEDDS_URI", "ROS_STATIC_PEERS"),
        ROS_LOCALHOST_ONLY="1",
        ROS_AUTOMATIC_DISCOVERY_RANGE="LOCALHOST",
        ROS_DOMAIN_ID=str(domain),
    )


def _configuration(prefix: str, folder: Path, domain: int) -> Mapping[str, Any]:
    limits = {"string": LIMITS.string, "sequence": LIMITS.sequence}
    carried: dict[str, Any] = {}
    for kind in KINDS.values():
        forth, back = topics("rosplc", kind.name)
        carried[forth] = {"type": kind.type_name, "to": "plc", "limits": limits}
        carried[back] = {"type": kind.type_name, "to": "ros", "limits": limits, "latched": False}
    return {
        "bridge": "bench",
        "prefix": prefix,
        "ros": {"backend": "dds", "distro": DISTRO, "domain": domain},
        "shm": {"directory": str(folder)},
        "diagnostics": {"enabled": False},
        "topics": carried,
    }


_NAMES = {"rosplc": "rosplc", "modbus": "Modbus TCP (pymodbus)", "opcua": "OPC UA (asyncua)"}


def render(data: Mapping[str, Any]) -> Page:
    """Return the page; see :class:`rosplc_bench.report.Section`."""
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


SECTION = Section(
    name="end-to-end",
    title="From a ROS 2 message to a PLC variable and back",
    question="What does each way between ROS 2 and a PLC cost, and what does it lose?",
    run=run,
    render=render,
    contenders=("rosplc", "modbus", "opcua"),
)
