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
from collections.abc import Iterator, Mapping
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from rosplc.demo.plan import FreeDomain
from rosplc.errors import SetupError
from rosplc_bench.draw import Cell, Figure, Series
from rosplc_bench.end_to_end_sides import DISTRO, KINDS, LIMITS, register_count, topics
from rosplc_bench.process import Side, free_port, python
from rosplc_bench.report import Page, Section, Table, median, paragraphs, percentile, text
from rosplc_bench.run import Context, need

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
    for one in (one for one in rounds if one["method"] == "rosplc"):
        what, parts = f"{one['kind']} over rosplc", (one["stream"], one["ping"])
        if torn := one["ping"]["plc"]["torn"] + sum(part["torn"] for part in parts):
            context.fail(what, f"{torn} torn messages")
        if not any(part["latencies_us"] for part in parts):
            context.fail(what, f"none of {sum(part['sent'] for part in parts)} messages came back")
        for part in parts:
            if part["latencies_us"] and (part["error"] or part["strings"] < KINDS[one["kind"]].strings()):
                context.fail(what, "the messages that came back differ from those sent")


def _methods(context: Context) -> list[str]:
    found = []
    for method, package in (("rosplc", "cyclonedds"), ("modbus", "pymodbus"), ("opcua", "asyncua")):
        with context.leaving_out(f"end to end over {method}"):
            if context.wants(method):
                need("cyclonedds")
                need(package)
                found.append(method)
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
                raise SetupError("SYS004", f"the ROS process found no bridge for {', '.join(missing)}")
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
        facts = {"cycle_ms": self._cycle_ms, "method": method, "kind": kind}
        return {**facts, "stream": stream, "ping": ping}


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
        lead=paragraphs("end-to-end lead", rate=data["rate_hz"]),
        tables=tuple(tables),
        figures=_figures(rows, cycles[0]),
        after=paragraphs("end-to-end after"),
        summary=tuple(_summary(rows)),
    )


def _rows(data: Mapping[str, Any], cycle: float) -> list[_Row]:
    rows = [_Row(data, cycle, kind, method) for kind in data["kinds"] for method in _NAMES]
    return [row for row in rows if row.turns]


class _Row:
    """One type over one method, all rounds together."""

    def __init__(self, data: Mapping[str, Any], cycle: float, kind: str, method: str) -> None:
        self.kind, self.method, self.facts = kind, method, data["kinds"][kind]
        self.name = f"{kind} over {_NAMES[method]}"
        key = (cycle, kind, method)
        self.turns = [one for one in data["rounds"] if (one["cycle_ms"], one["kind"], one["method"]) == key]
        self.latencies = sorted(value for one in self.turns for value in one["stream"]["latencies_us"])
        self.parts = [one[part] for one in self.turns for part in ("stream", "ping")]
        self.back = sum(len(part["latencies_us"]) for part in self.parts)
        self.sent, self.received, self.torn_ros = (
            sum(part[what] for part in self.parts) for what in ("sent", "received", "torn")
        )
        self.seen, self.torn_plc = (
            sum(one["ping"]["plc"][what] for one in self.turns) for what in ("seen", "torn")
        )
        whole = [part for part in self.parts if part["latencies_us"]]
        self.error = max((part["error"] for part in whole), default=None)
        self.strings = min((part["strings"] for part in whole), default=None)

    def medians(self) -> list[float | None]:
        """Return each round's median latency in µs, in the order of rounds; None for none."""
        return [median(one["stream"]["latencies_us"]) for one in self.turns]

    def rate(self) -> float | None:
        pings = [one["ping"] for one in self.turns if one["ping"]["seconds"]]
        return median(len(ping["latencies_us"]) / ping["seconds"] for ping in pings)

    def cpu(self, which: int) -> float | None:
        return median(100 * one["stream"]["cpu"][which] for one in self.turns)

    def carried(self) -> str:
        """Return what of the message's structure the PLC's program meets."""
        return {
            "rosplc": "1 struct of the type",
            "modbus": f"{self.facts['registers']} registers without names or types",
            "opcua": f"{self.facts['leaves']} nodes with names",
        }[self.method]


def _times(data: Mapping[str, Any], rows: list[_Row], cycle: float) -> Table:
    reference = {row.kind: row.medians() for row in rows if row.method == "rosplc"}
    lines: list[tuple[Cell, ...]] = []
    for row in rows:
        found, pairs = row.latencies, zip(row.medians(), reference.get(row.kind, []), strict=False)
        ratio = median(one / other for one, other in pairs if one is not None and other is not None)
        spread = (percentile(found, 99), found[-1]) if found else (None, None)
        lines.append((row.name, median(found), *spread, ratio, row.rate(), row.cpu(0), row.cpu(1)))
    header = (
        *("round trip", "median µs", "p99 µs", "max µs", "÷ rosplc"),
        *("round trips/s", "bridge CPU %", "PLC CPU %"),
    )
    title = f"Round trips with a PLC task of {cycle:g} ms"
    waiting, note = text("end-to-end waiting", cycle=cycle), text("end-to-end times", rate=data["rate_hz"])
    return Table(title, header, tuple(lines), waiting, note)


def _losses(rows: list[_Row], cycle: float) -> Table:
    lines: list[tuple[Cell, ...]] = []
    for row in rows:
        strings = row.facts["strings"]
        kept = "–" if not strings else "?" if row.strings is None else f"{row.strings} of {strings}"
        error = "?" if row.error is None else "exact" if row.error == 0 else f"off by up to {row.error:.0e}"
        torn = (f"{row.torn_plc:,} of {row.seen:,}", f"{row.torn_ros:,} of {row.received:,}")
        lines.append((row.name, row.carried(), kept, error, row.sent, row.sent - row.back, *torn))
    header = (
        *("losses", "structure on the PLC's side", "strings kept", "64-bit numbers"),
        *("sent", "not returned intact", "torn at the PLC", "torn in ROS"),
    )
    title = f"Losses with a PLC task of {cycle:g} ms"
    waiting = text("end-to-end waiting", cycle=cycle)
    return Table(title, header, tuple(lines), waiting, text("end-to-end losses"))


def _figures(rows: list[_Row], cycle: float) -> tuple[Figure, ...]:
    def bars(name: str, title: str, unit: str, values: Mapping[_Row, float]) -> Figure:
        series = (Series(row.name, (), (value,), row.method) for row, value in values.items())
        return Figure(name, f"{title} (PLC task every {cycle:g} ms)", "", unit, tuple(series), kind="bars")

    times = {row: statistics.median(row.latencies) / 1000 for row in rows if row.latencies}
    torn = {row: 100 * row.torn_plc / row.seen for row in rows if row.seen}
    seen = "Torn messages that the PLC's program saw"
    return (
        bars("end-to-end", "ROS 2 to the PLC and back, median", "ms", times),
        bars("end-to-end-torn", seen, "% of the messages seen", torn),
    )


def _summary(rows: list[_Row]) -> Iterator[str]:
    for method in dict.fromkeys(row.method for row in rows):
        mine = [row for row in rows if row.method == method]
        middle = median(value for row in mine for value in row.latencies)
        if middle is not None:
            torn, seen = sum(row.torn_plc for row in mine), sum(row.seen for row in mine)
            yield (
                f"ROS 2 to the PLC and back over {_NAMES[method]}: median {middle / 1000:.1f} ms, {torn} of "
                f"{seen} messages torn at the PLC."
            )


SECTION = Section(
    name="end-to-end",
    title="From a ROS 2 message to a PLC variable and back",
    question="What does each way of exchanging data between ROS 2 and a PLC cost, and what does it lose?",
    run=run,
    render=render,
    contenders=("rosplc", "modbus", "opcua"),
)
