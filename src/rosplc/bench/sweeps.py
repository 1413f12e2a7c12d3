"""The sweeps: one message one way by its size, and one message on each of many topics.

For each size and number all contenders are up at once and take turns, each as often as fits into some
milliseconds.
"""

from __future__ import annotations

import resource
from collections.abc import Iterable, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

from rosplc.bench.compiling import compile_program, find_library
from rosplc.bench.context import Context
from rosplc.bench.end_to_end_child import WATCHDOG_S, python
from rosplc.bench.free_port import free_port
from rosplc.bench.missing import Missing
from rosplc.bench.optional import need
from rosplc.bench.process import Side
from rosplc.bench.section import Section
from rosplc.bench.sweeps_contenders import (
    Contender,
    OpcUaClient,
    channels,
    memcpy_python,
    program,
    pymodbus_there,
    pymodbus_there_and_back,
    rosplc_python,
    topics_python,
    twist,
)
from rosplc.bench.sweeps_page import PAYLOAD_NAMES, TOPIC_NAMES, render
from rosplc.bench.sweeps_server import FIELDS, START_SECONDS
from rosplc.errors import ChannelError, SetupError

__all__ = ["SECTION", "run"]

_SIZES = (8, 64, 512, 4096, 32768, 262144, 2097152, 8388608)
_FEW_SIZES = (8, 512, 32768, 8388608)
_MODBUS_MOST = 131072
"""Bytes in all 65,536 registers: Modbus addresses no more."""
_TOPICS = (1, 3, 10, 30, 100, 300, 1000)

_EFFORTS: dict[str, dict[str, Any]] = {
    "quick": {"rounds": 1, "turn_ms": 2.0, "sizes": _FEW_SIZES, "topics": (1, 10, 100), "server_most": 10},
    "default": {
        "rounds": 3,
        "turn_ms": 5.0,
        "sizes": _SIZES,
        "topics": (1, 10, 100, 1000),
        "server_most": 100,
    },
    "full": {"rounds": 9, "turn_ms": 30.0, "sizes": _SIZES, "topics": _TOPICS, "server_most": 1000},
}
"""By effort; ``server_most``: the most topics asked of OPC UA's server, which makes its nodes slowly."""

_FILES_PER_TOPIC, _FILES_BESIDE = 3, 200

_SLOW_MS = 250.0
"""A contender whose message takes longer is measured once per size."""


def run(context: Context) -> dict[str, Any]:
    """Measure; see :class:`rosplc.bench.section.Section`."""
    effort = _EFFORTS[context.effort.name]
    if not any(context.wants(name) for name in SECTION.contenders):
        return {}
    data: dict[str, Any] = {"payload": [], "topics": [], "server_most": effort["server_most"]}
    with ExitStack() as stack:
        around = Around(context, effort, stack)
        total = len(effort["sizes"]) + len(effort["topics"])
        for done, size in enumerate(effort["sizes"]):
            context.notify(done, total, f"one message of {size} bytes")
            try:
                with ExitStack() as here:
                    found = _turns(context, around.payload(size, here), effort)
            except ChannelError as error:
                if error.code != "SHM117":
                    raise
                context.skip(f"one message of {size} bytes", error.what, "make room in /dev/shm")
                continue
            data["payload"] += [{"size": size, "contender": name, "ns": ns} for name, ns in found.items()]
        for done, count in enumerate(effort["topics"]):
            context.notify(len(effort["sizes"]) + done, total, f"{count} topics")
            try:
                with ExitStack() as here, _files(_FILES_PER_TOPIC * count + _FILES_BESIDE):
                    found = _turns(context, around.topics(count, here), effort)
            except Missing as missing:
                context.skip(f"{count} topics", missing.reason, missing.remedy)
                continue
            data["topics"] += [{"topics": count, "contender": name, "ns": ns} for name, ns in found.items()]
    return data


@contextmanager
def _files(count: int) -> Iterator[None]:
    """Allow this process to hold so many open files; an object's owner holds one for its lock."""
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    if soft == resource.RLIM_INFINITY or soft >= count:
        yield
        return
    try:
        resource.setrlimit(resource.RLIMIT_NOFILE, (count, hard))
    except (OSError, ValueError):
        raise Missing(f"only {soft} files may be open at once", f"ulimit -n {count}") from None
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_NOFILE, (soft, hard))


def _turns(
    context: Context, contenders: Iterable[Contender], effort: dict[str, Any]
) -> dict[str, list[float]]:
    """Let all measure once per round; return what each found, by name."""
    values: dict[str, list[float]] = {}
    counts: dict[Contender, int] = {}
    for number in range(-1, effort["rounds"]):
        for contender in contenders:
            if number >= 0 and contender not in counts:
                continue  # it failed, or takes too long to be asked again
            try:
                if number < 0:
                    counts[contender] = _calibrated(contender, effort["turn_ms"])
                    continue
                found = contender(counts[contender])
            except Exception as error:  # one that fails is no reason to lose the others
                context.fail("sweeps", f"{type(error).__name__}: {error}")
                counts.pop(contender, None)
                continue
            for name, ns in found.items():
                values.setdefault(name, []).append(ns)
            if max(found.values()) > _SLOW_MS * 1e6:
                del counts[contender]
    return {name: found for name, found in values.items() if context.wants(name)}


def _calibrated(contender: Contender, turn_ms: float) -> int:
    """Return how often a contender can do it in a turn; it has run once before anything counts."""
    slowest = max(contender(1).values())
    if slowest < turn_ms * 1e6:
        slowest = max(contender(2).values())
    return max(1, min(20_000, int(turn_ms * 1e6 / slowest)))


class Around:
    """What lives through all sizes: the servers, and the compiled program."""

    def __init__(self, context: Context, effort: dict[str, Any], stack: ExitStack) -> None:
        self._scratch = context.scratch
        self._most = int(effort["server_most"])
        self._program, self._modbus_port = _native(context, stack)
        self._pymodbus_port = self._server(context, "modbus", "pymodbus", stack)
        port = self._server(context, "opcua", "asyncua", stack)
        self._opcua: OpcUaClient | None = None
        if port:
            self._opcua = OpcUaClient(port)
            stack.callback(self._opcua.close)

    def _server(self, context: Context, method: str, package: str, stack: ExitStack) -> int:
        if not context.wants(package):
            return 0
        try:
            need(package)
        except Missing as missing:
            context.skip(f"sweeps over {package}", missing.reason, missing.remedy)
            return 0
        port = free_port()
        side = Side(f"{package} server", python("sweeps_server", method, str(port), str(self._most)))
        stack.callback(side.close)
        try:
            side.hear_json(START_SECONDS + WATCHDOG_S)
        except SetupError as error:  # the others go on
            context.fail(f"sweeps over {package}", error.what)
            return 0
        return port

    def payload(self, size: int, stack: ExitStack) -> list[Contender]:
        """Start those who can carry a message of ``size`` bytes."""
        found: list[Contender] = []
        if self._program is not None:
            path = channels(self._scratch, 1, size, stack)[0].path
            found.append(self._c("payload", str(path), size, stack))
            if self._modbus_port and size <= _MODBUS_MOST:
                registers = self._c("modbus", str(self._modbus_port), size, stack)
                found.append(lambda often: {"libmodbus": registers(often)["modbus"]})
        found.append(rosplc_python(channels(self._scratch, 1, size, stack)[0], size))
        found.append(memcpy_python(size))
        if self._pymodbus_port and size <= _MODBUS_MOST:
            found.append(pymodbus_there(self._pymodbus_port, size, stack))
        if self._opcua is not None:
            found.append(self._opcua.payload(size))
        return found

    def topics(self, count: int, stack: ExitStack) -> list[Contender]:
        """Start those who can carry so many topics."""
        # Before a thousand objects are open: select(), on which pymodbus' client stands, takes only low
        # numbers of files.
        servers: list[Contender] = []
        if self._pymodbus_port:
            servers.append(pymodbus_there_and_back(self._pymodbus_port, count, stack))
        if self._opcua is not None and count <= self._most:
            servers.append(self._opcua.topics(count))
        found: list[Contender] = []
        size = twist().size
        if self._program is not None:
            paths = [str(channel.path) for channel in channels(self._scratch, count, size, stack)]
            listed = self._scratch / f"topics-{count}"
            listed.write_text("\n".join(paths) + "\n")
            found.append(self._c("topics", str(listed), size, stack))
            if self._modbus_port:
                registers = self._c("modbus", str(self._modbus_port), count * FIELDS * 4, stack)
                found.append(lambda often: {"libmodbus": registers(often)["there and back"]})
        found.append(topics_python(channels(self._scratch, count, size, stack)))
        return found + servers

    def _c(self, what: str, place: str, size: int, stack: ExitStack) -> Contender:
        return program(f"sweep {what}", [str(self._program), what, place, str(size)], stack)


def _native(context: Context, stack: ExitStack) -> tuple[Path | None, int]:
    """Return the program in C and the port of its Modbus server; None and 0 for what is missing."""
    options: tuple[str, ...] = ()
    try:
        options = ("-DWITH_MODBUS", *find_library("libmodbus", "libmodbus-dev"))
    except Missing as missing:
        context.skip("sweeps over libmodbus", missing.reason, missing.remedy)
    try:
        found = compile_program("sweep", context.cache, options=options)
    except Missing as missing:
        context.skip("sweeps in C", missing.reason, missing.remedy)
        return None, 0
    if not options:
        return found, 0
    server = Side("libmodbus server", [str(found), "modbus-server"])
    stack.callback(server.close, 0.1)  # it serves for ever, and takes no orders
    return found, int(server.hear_json(WATCHDOG_S)["port"])


SECTION = Section(
    name="sweeps",
    title="By size of the message, and by number of topics",
    question="Where does copying begin to matter, and how many topics can be carried?",
    run=run,
    render=render,
    contenders=tuple(dict.fromkeys((*PAYLOAD_NAMES, *TOPIC_NAMES))),
)
