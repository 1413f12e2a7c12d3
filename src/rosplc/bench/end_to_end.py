"""The end-to-end comparison: ROS 2 message → PLC variable and back, over three ways.

One ROS process sends by turns over rosplc, over Modbus TCP registers and over OPC UA nodes; each way has a
bridge process and a PLC process of its own, all of which live through the whole run. What a way loses is
computed from what came back: :mod:`rosplc.bench.end_to_end_messages` makes messages that tell.
"""

from __future__ import annotations

import json
import secrets
import time
from collections.abc import Mapping
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from rosplc.bench.context import Context
from rosplc.bench.end_to_end_child import WATCHDOG_S, ask, python
from rosplc.bench.end_to_end_messages import KINDS
from rosplc.bench.end_to_end_page import render
from rosplc.bench.end_to_end_registers import size
from rosplc.bench.end_to_end_ros import DISTRO, LIMITS, topics
from rosplc.bench.free_port import free_port
from rosplc.bench.missing import Missing
from rosplc.bench.optional import need
from rosplc.bench.process import Side
from rosplc.bench.section import Section
from rosplc.demo.domain import FreeDomain
from rosplc.errors import SetupError

__all__ = ["SECTION", "run"]

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
    """Measure; see :class:`rosplc.bench.section.Section`."""
    amount = _AMOUNTS[context.effort.name]
    methods = _methods(context)
    if not methods:
        return {}
    data: dict[str, Any] = {
        "rate_hz": RATE_HZ,
        "rounds": [],
        "kinds": {
            name: {"strings": kind.strings(), "leaves": len(kind.paths), "registers": size(kind)}
            for name, kind in KINDS.items()
        },
    }
    total = len(amount.cycles_ms) * amount.rounds * len(methods) * len(KINDS)
    for cycle_ms in amount.cycles_ms:
        with ExitStack() as stack:
            cell = Cell(context, methods, cycle_ms, stack)
            for number in range(amount.rounds):
                for kind in KINDS:
                    for method in tuple(cell.methods):
                        what = f"{kind} over {method}, round {number + 1}"
                        context.notify(len(data["rounds"]), total, what)
                        try:
                            data["rounds"].append(cell.measure(method, kind, amount))
                        except SetupError as error:  # the others go on
                            context.fail(f"{kind} over {method}", error.what)
                            cell.methods.remove(method)
    _check(context, data["rounds"])
    return data if data["rounds"] else {}


def _check(context: Context, rounds: list[dict[str, Any]]) -> None:
    """Say it if rosplc did not do what it promises; of the others nothing is demanded."""
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


class Cell:
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

        def start(role: str, module: str, *arguments: str) -> Side:
            side = Side(role, _local(domain.number, module, *arguments))
            stack.callback(side.close)
            return side

        plan = {"domain": domain.number, "methods": methods, "kinds": list(KINDS)}
        self._ros = start("ROS", "end_to_end_ros", json.dumps(plan))
        places: dict[str, Any] = {}
        if "rosplc" in methods:  # objects before the PLC looks for them
            self._bridges["rosplc"] = start("bridge", "end_to_end_bridge", "rosplc", json.dumps(common))
        for method in methods:
            places[method] = [prefix, str(context.scratch)] if method == "rosplc" else free_port()
            order = {"cycle": cycle_ms / 1000, "where": places[method]}
            self._plcs[method] = start(f"{method} PLC", "end_to_end_plc", method, json.dumps(order))
        self._ready(context, self._plcs)
        for method in self.methods:
            if method != "rosplc":
                order = {**common, "where": places[method]}
                self._bridges[method] = start(
                    f"{method} bridge", "end_to_end_bridge", method, json.dumps(order)
                )
        self._ros.hear_json(WATCHDOG_S)
        self._ready(context, self._bridges)
        self._find_each_other()
        for kind in KINDS:  # everything has run once before anything counts
            for method in self.methods:
                self._begin(method, kind)
                ask(self._ros, do="ping", method=method, kind=kind, seconds=0.05)

    def _ready(self, context: Context, sides: Mapping[str, Side]) -> None:
        """Wait until they are up; whoever does not come up is left out, and the others go on."""
        for method in tuple(self.methods):
            try:
                sides[method].hear_json(WATCHDOG_S)
            except SetupError as error:
                context.fail(f"end to end over {method}", error.what)
                self.methods.remove(method)

    def _find_each_other(self) -> None:
        end = time.monotonic() + _FIND_S
        while missing := [
            line for line in ask(self._ros, do="ready")["missing"] if line.split()[0] in self.methods
        ]:
            if time.monotonic() > end:
                raise SetupError("SYS004", f"the ROS process finds no bridge for {', '.join(missing)}")
            time.sleep(0.05)

    def _begin(self, method: str, kind: str) -> None:
        ask(self._plcs[method], kind=kind)
        ask(self._bridges[method], kind=kind)

    def measure(self, method: str, kind: str, amount: Amount) -> dict[str, Any]:
        """Measure one turn: a stream, then a ping-pong."""
        self._begin(method, kind)
        bridge, plc = self._bridges[method], self._plcs[method]
        before = [side.cpu_seconds() for side in (bridge, plc)]
        stream = ask(self._ros, do="stream", method=method, kind=kind, count=amount.messages, rate=RATE_HZ)
        after = [side.cpu_seconds() for side in (bridge, plc)]
        stream["cpu"] = [(b - a) / stream["seconds"] for a, b in zip(before, after, strict=True)]
        stream["plc"] = ask(plc, report=True)
        ping = ask(self._ros, do="ping", method=method, kind=kind, seconds=amount.seconds)
        ping["plc"] = ask(plc, report=True)
        return {
            "cycle_ms": self._cycle_ms,
            "method": method,
            "kind": kind,
            "stream": stream,
            "ping": ping,
        }


def _local(domain: int, module: str, *arguments: str) -> list[str]:
    """Return the command line of a process whose ROS stays on this machine."""
    return python(
        module,
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


SECTION = Section(
    name="end-to-end",
    title="From a ROS 2 message to a PLC variable and back",
    question="What does each way between ROS 2 and a PLC cost, and what does it lose?",
    run=run,
    render=render,
    contenders=("rosplc", "modbus", "opcua"),
)
