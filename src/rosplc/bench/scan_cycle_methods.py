"""The methods of the scan-cycle view: a PLC task and the other side of it, each a process."""

from __future__ import annotations

import json
import secrets
from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

from rosplc.bench.compiling import compile_program, find_library
from rosplc.bench.context import Context
from rosplc.bench.end_to_end_child import WATCHDOG_S, python
from rosplc.bench.free_port import free_port
from rosplc.bench.missing import Missing
from rosplc.bench.optional import need
from rosplc.bench.process import Side
from rosplc.errors import SetupError
from rosplc.shm import Description, Direction, Namespace, OwnedChannel

__all__ = ["NAMES", "Method", "Programs", "start"]

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


@dataclass(frozen=True)
class Programs:
    """The two programs in C, and whether they know Modbus."""

    task: Path
    peer: Path
    modbus: bool

    @classmethod
    def compiled(cls, context: Context) -> Programs | None:
        """Compile them; None, and a note why, where that is not possible."""
        options: tuple[str, ...] = ()
        try:
            options = ("-DWITH_MODBUS", *find_library("libmodbus", "libmodbus-dev"))
        except Missing as missing:
            context.skip("scan cycle over Modbus TCP (C)", missing.reason, missing.remedy)
        try:
            task, peer = (
                compile_program(name, context.cache, options=options) for name in ("scan_task", "scan_peer")
            )
        except Missing as missing:
            context.skip("scan cycle in C", missing.reason, missing.remedy)
            return None
        return cls(task, peer, bool(options))


def start(context: Context, programs: Programs | None, stack: ExitStack) -> list[Method]:
    """Start every method that this machine has; they end with ``stack``."""
    starters: dict[str, Callable[[], tuple[Side, Side]]] = {}

    def run(name: str, command: list[str]) -> Side:
        side = Side(name, command)
        stack.callback(side.close)
        return side

    def ready(side: Side) -> int:
        return int(side.hear_json(WATCHDOG_S)["port"])

    def in_c(method: str, *places: str) -> tuple[Side, Side]:
        assert programs is not None
        peer = run(f"{method} peer", [str(programs.peer), method, *reversed(places)])
        ready(peer)
        task = run(f"{method} task", [str(programs.task), method, *places])
        ready(task)
        return task, peer

    def modbus(method: str) -> tuple[Side, Side]:
        assert programs is not None
        commands = {"task": str(programs.task), "peer": str(programs.peer)}
        server, client = ("task", "peer") if method == "modbus-slave" else ("peer", "task")
        sides = {server: run(f"{method} {server}", [commands[server], method])}
        port = ready(sides[server])
        sides[client] = run(f"{method} {client}", [commands[client], method, str(port)])
        ready(sides[client])
        return sides["task"], sides["peer"]

    def in_python(method: str, to_task: dict[str, Any], to_peer: dict[str, Any]) -> tuple[Side, Side]:
        def one(role: str, plan: dict[str, Any]) -> Side:
            return run(f"{method} {role}", python("scan_cycle_python", role, method, json.dumps(plan)))

        task = one("task", to_task)
        if method == "rosplc":  # neither needs the other to begin with
            peer = one("peer", to_peer)
            ready(task)
        else:
            ready(task)
            peer = one("peer", to_peer)
        ready(peer)
        return task, peer

    def channels() -> tuple[str, str]:
        return _channel(context, stack, Direction.TO_PLC), _channel(context, stack, Direction.TO_ROS)

    def rosplc_python() -> tuple[Side, Side]:
        to_plc, to_ros = channels()
        return in_python("rosplc", {"out": to_ros, "in": to_plc}, {"out": to_plc, "in": to_ros})

    def opcua_python() -> tuple[Side, Side]:
        port = {"port": free_port()}
        return in_python("opcua", port, port)

    if programs is not None:
        starters["none"] = lambda: in_c("none")
        starters["rosplc"] = lambda: in_c("rosplc", *channels())
        for name in ("semaphore", "plain"):
            areas = str(context.scratch / f"areas-{secrets.token_hex(4)}")
            starters[name] = partial(in_c, name, areas)
        if programs.modbus:
            starters["modbus-slave"] = lambda: modbus("modbus-slave")
            starters["modbus-master"] = lambda: modbus("modbus-master")
    if context.effort.name == "quick":
        context.skip("scan cycle in Python, OPC UA among it", "left out of a quick run", "leave --quick out")
    else:
        starters["rosplc-python"] = rosplc_python
        try:
            need("asyncua")
            starters["opcua-python"] = opcua_python
        except Missing as missing:
            context.skip("scan cycle over OPC UA", missing.reason, missing.remedy)
    found = []
    for name, starter in starters.items():
        if not context.wants(name):
            continue
        try:
            found.append(Method(name, *starter()))
        except SetupError as error:  # the others go on
            context.fail(f"scan cycle, {NAMES[name]}", error.what)
    return found


def _channel(context: Context, stack: ExitStack, direction: Direction) -> str:
    namespace = Namespace(f"scan-{secrets.token_hex(4)}", str(context.scratch))
    topic = f"/scan/{'to_plc' if direction is Direction.TO_PLC else 'to_ros'}"
    about = Description(topic, "std_msgs/msg/Empty", "jazzy", direction, {}, "0" * 16, "bench", "uint8 x")
    channel = stack.enter_context(OwnedChannel.open(namespace, about, record_size=BYTES))
    return str(channel.path)
