"""The sweeps: one message one way by its size, and one message on each of many topics.

For each size and number all contenders are up at once and take turns, each as often as fits into some
milliseconds. A contender is a function that takes a number of repetitions, and returns nanoseconds per
message (or per round over all topics) by name; each compares what arrived with what was sent.

``python -m rosplc_bench.sweeps modbus|opcua PORT TOPICS`` runs a server.
"""

from __future__ import annotations

import logging
import resource
import statistics
import sys
import time
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any, NamedTuple, TypeAlias

from rosplc.codec import Codec, Wire
from rosplc.errors import ChannelError, SetupError
from rosplc.layout import Limits, compute_layout
from rosplc.model import TypeStore
from rosplc.shm import OwnedChannel, Reader, Writer
from rosplc_bench.compiling import compile_with_modbus
from rosplc_bench.contenders import channels
from rosplc_bench.draw import Cell, Figure, Series, size_text
from rosplc_bench.process import WATCHDOG_S, Side, free_port, python, reply, requests
from rosplc_bench.protocols import ModbusClient, OpcUaClient, Variable, serve_modbus, serve_opcua
from rosplc_bench.report import Page, Section, Table, paragraphs, text
from rosplc_bench.run import Context, Missing, need

Contender: TypeAlias = Callable[[int], Mapping[str, float]]
Medians: TypeAlias = Mapping[str, Mapping[int, float]]
Scale: TypeAlias = Callable[[float, float], float]

FIELDS = 6
"""Numbers of a topic: those of a Twist."""
_MODBUS_MOST = 131072
"""Bytes in all 65,536 registers: Modbus addresses no more."""
_START_SECONDS = 300.0
"""asyncua makes some hundred nodes per second, on a small board tens; there are 6,000 in a full run."""
_SLOW_MS = 250.0
"""A contender whose message takes longer is measured once per size."""
_FILES_PER_TOPIC, _FILES_BESIDE = 3, 200

_SIZES = (8, 64, 512, 4096, 32768, 262144, 2097152, 8388608)


class Amount(NamedTuple):
    """How much is measured.

    Attributes:
        rounds: How often all take turns.
        turn_ms: How long a turn may take.
        sizes: Sizes of a message.
        topics: Numbers of topics.
        server_most: The most topics asked of OPC UA's server, which makes its nodes slowly.
    """

    rounds: int
    turn_ms: float
    sizes: tuple[int, ...]
    topics: tuple[int, ...]
    server_most: int


_AMOUNTS = {
    "quick": Amount(1, 2.0, (8, 512, 32768, 8388608), (1, 10, 100), 10),
    "default": Amount(3, 5.0, _SIZES, (1, 10, 100, 1000), 100),
    "full": Amount(9, 30.0, _SIZES, (1, 3, 10, 30, 100, 300, 1000), 1000),
}
"""By effort."""

PAYLOAD_NAMES = {
    "memcpy": "memcpy in and out (C)",
    "rosplc": "rosplc (C)",
    "semaphore": "shm, semaphore (C)",
    "memcpy-python": "memcpy in and out (Python)",
    "rosplc-python": "rosplc (Python)",
    "libmodbus": "Modbus TCP (libmodbus, C)",
    "pymodbus": "Modbus TCP (pymodbus)",
    "asyncua": "OPC UA (asyncua)",
}
"""Contender → its name where the size of the message varies."""

TOPIC_NAMES = {
    "rosplc": "rosplc (C)",
    "rosplc-batched": "rosplc, one call for all (Python)",
    "rosplc-single": "rosplc, one by one (Python)",
    "libmodbus": "Modbus TCP (libmodbus, C)",
    "pymodbus": "Modbus TCP (pymodbus)",
    "asyncua": "OPC UA (asyncua)",
}
"""Contender → its name where the number of topics varies."""


def run(context: Context) -> dict[str, Any]:
    """Measure; see :class:`rosplc_bench.report.Section`."""
    amount = _AMOUNTS[context.effort.name]
    if not any(context.wants(name) for name in SECTION.contenders):
        return {}
    data: dict[str, Any] = {"payload": [], "topics": [], "server_most": amount.server_most}
    with ExitStack() as stack:
        sweep = Sweep(context, amount, stack)
        steps = [("payload", "size", size) for size in amount.sizes]
        steps += [("topics", "topics", count) for count in amount.topics]
        for done, (kind, key, value) in enumerate(steps):
            what = f"one message of {value} bytes" if kind == "payload" else f"{value} topics"
            context.notify(done, len(steps), what)
            files = _files(_FILES_PER_TOPIC * value if kind == "topics" else 0)
            try:
                with context.leaving_out(what), ExitStack() as here, files:
                    found = _turns(context, getattr(sweep, kind)(value, here), amount)
                    data[kind] += [{key: value, "contender": name, "ns": ns} for name, ns in found.items()]
            except ChannelError as error:
                if error.code != "SHM117":
                    raise
                context.skip(what, error.what, "free space in /dev/shm")
    return data


@contextmanager
def _files(count: int) -> Iterator[None]:
    """Allow this process to hold so many open files; an object's owner holds one for its lock."""
    count += _FILES_BESIDE
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


def _turns(context: Context, contenders: Iterable[Contender], amount: Amount) -> dict[str, list[float]]:
    """Let all measure once per round; return what each found, by name."""
    values: dict[str, list[float]] = {}
    counts = dict.fromkeys(contenders, 0)
    for _ in range(amount.rounds):
        for contender, count in tuple(counts.items()):
            try:
                counts[contender] = count or _calibrated(contender, amount.turn_ms)
                found = contender(counts[contender])
            except Exception as error:  # one that fails is no reason to lose the others
                context.fail("sweeps", f"{type(error).__name__}: {error}")
                del counts[contender]
                continue
            for name, ns in found.items():
                values.setdefault(name, []).append(ns)
            if max(found.values()) > _SLOW_MS * 1e6:
                del counts[contender]  # it takes too long to be asked again
    return {name: found for name, found in values.items() if context.wants(name)}


def _calibrated(contender: Contender, turn_ms: float) -> int:
    """Return how often a contender can do it in a turn; it has run once before anything counts."""
    slowest = max(contender(1).values())
    if slowest < turn_ms * 1e6:
        slowest = max(contender(2).values())
    return max(1, min(20_000, int(turn_ms * 1e6 / slowest)))


class Sweep:
    """What lives through all sizes: the servers, and the compiled program."""

    def __init__(self, context: Context, amount: Amount, stack: ExitStack) -> None:
        self._scratch, self._most = context.scratch, amount.server_most
        self._program, self._modbus_port = _native(context, stack)
        self._pymodbus_port = self._server(context, "modbus", "pymodbus", stack)
        port = self._server(context, "opcua", "asyncua", stack)
        self._opcua = OpcUaClient(port) if port else None
        if self._opcua is not None:
            stack.callback(self._opcua.close)

    def _server(self, context: Context, method: str, package: str, stack: ExitStack) -> int:
        with context.leaving_out(f"sweeps over {package}"):
            if context.wants(package):
                need(package)
                port = free_port()
                server = Side(f"{package} server", python("sweeps", method, str(port), str(self._most)))
                stack.enter_context(server).receive_json(_START_SECONDS + WATCHDOG_S)
                return port
        return 0

    def payload(self, size: int, stack: ExitStack) -> list[Contender]:
        """Start the contenders that can carry a message of ``size`` bytes."""
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
            found.append(pymodbus(self._pymodbus_port, (size + 1) // 2, stack, back=False))
        if self._opcua is not None:
            found.append(opcua_payload(self._opcua, size))
        return found

    def topics(self, count: int, stack: ExitStack) -> list[Contender]:
        """Start the contenders that can carry so many topics."""
        # Before a thousand objects are open: select(), which pymodbus' client uses, takes only low numbers
        # of files.
        servers: list[Contender] = []
        if self._pymodbus_port:
            servers.append(pymodbus(self._pymodbus_port, count * FIELDS * 2, stack, back=True))
        if self._opcua is not None and count <= self._most:
            servers.append(opcua_topics(self._opcua, count))
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
    program, with_modbus = compile_with_modbus(context, "sweeps", "sweep")
    if program is None or not with_modbus:
        return program, 0
    server = Side("libmodbus server", [str(program), "modbus-server"])
    stack.callback(server.close, 0.1)  # it serves until it is killed
    return program, int(server.receive_json()["port"])


def program(name: str, command: list[str], stack: ExitStack) -> Contender:
    """Return the contenders of a running C program."""
    side = Side(name, command)
    stack.callback(side.close)

    return lambda count: side.ask(str(count))


def _check(arrived: bool) -> None:
    if not arrived:
        raise SetupError("SYS002", "the messages received differ from those sent")


def rosplc_python(channel: OwnedChannel, size: int) -> Contender:
    """Return the channel from Python: one publication and one taking into a buffer."""
    writer = Writer(channel.region, 0, 1000)
    reader = Reader(channel.region, writer.head)
    record, out = bytearray(size), bytearray(size)

    def measure(count: int) -> Mapping[str, float]:
        publish, update = writer.publish, reader.update
        record[-1] ^= 1
        began = time.perf_counter_ns()
        for _ in range(count):
            publish(record)
            update(out)
        spent = time.perf_counter_ns() - began
        _check(out == record)
        return {"rosplc-python": spent / count}

    return measure


def memcpy_python(size: int) -> Contender:
    """Return an assignment between memoryviews, in and out, over as many buffers as a channel has."""
    record, out, *slots = (memoryview(bytearray(size)) for _ in range(6))

    def measure(count: int) -> Mapping[str, float]:
        began = time.perf_counter_ns()
        for turn in range(count):
            slot = slots[turn & 3]
            slot[:] = record
            out[:] = slot
        return {"memcpy-python": (time.perf_counter_ns() - began) / count}

    return measure


def topics_python(made: list[OwnedChannel]) -> Contender:
    """Return the bridge's way over many topics, in one call and one by one; both encode for ROS."""
    from rosplc.shm import Group

    plan = Codec(twist(), Wire.CDR).plan
    writers = [Writer(channel.region, 0, 1000) for channel in made]
    batched = [Reader(channel.region, writer.head) for channel, writer in zip(made, writers, strict=True)]
    single = [Reader(channel.region, writer.head) for channel, writer in zip(made, writers, strict=True)]
    group = Group()
    for reader in batched:
        group.add_reader(reader, plan)
    record = bytes(plan.record_size)

    def one_by_one() -> int:
        return sum(reader.latest_wire(plan) is not None for reader in single)

    def in_one_call() -> int:
        return len(group.take()[0])

    def measure(count: int) -> Mapping[str, float]:
        found = {}
        for name, take in (("rosplc-batched", in_one_call), ("rosplc-single", one_by_one)):
            took = 0
            began = time.perf_counter_ns()
            for _ in range(count):
                for writer in writers:
                    writer.publish(record)
                took += take()
            found[name] = (time.perf_counter_ns() - began) / count
            _check(took == count * len(made))
            in_one_call(), one_by_one()  # what the other way has left
        return found

    return measure


def twist() -> Any:
    """Return the layout of the topics' type."""
    return compute_layout(TypeStore.bundled("jazzy"), "geometry_msgs/msg/Twist", Limits())


def pymodbus(port: int, registers: int, stack: ExitStack, *, back: bool) -> Contender:
    """Return pymodbus writing all registers, and with ``back`` reading them as well."""
    client = ModbusClient(port)
    stack.callback(client.close)
    turn = 0

    def measure(count: int) -> Mapping[str, float]:
        nonlocal turn
        turn += 1
        values = [turn % 65536] * registers
        found: list[int] = []
        began = time.perf_counter_ns()
        for _ in range(count):
            client.write(0, values)
            if back:
                found = client.read(0, registers)
        spent = time.perf_counter_ns() - began
        _check((found or client.read(0, registers)) == values)
        return {"pymodbus": spent / count}

    return measure


def opcua_payload(client: OpcUaClient, size: int) -> Contender:
    """Return writing one node of ``size`` bytes."""
    node, turn = client.node("payload"), 0

    async def work(count: int, value: Any) -> float:
        began = time.perf_counter_ns()
        for _ in range(count):
            await node.write_value(value)
        return (time.perf_counter_ns() - began) / count

    def measure(count: int) -> Mapping[str, float]:
        nonlocal turn
        turn += 1
        content = bytes([turn % 256]) * size
        spent = client.run(work(count, client.value(content, "ByteString")))
        _check(client.run(node.read_value()) == content)
        return {"asyncua": spent}

    return measure


def opcua_topics(client: OpcUaClient, topics: int) -> Contender:
    """Return writing and reading all nodes of so many topics, in one request each way."""
    nodes = [client.node(f"{topic}.{field}") for topic in range(topics) for field in range(FIELDS)]
    turn = 0.0

    async def work(count: int, values: list[Any]) -> tuple[float, list[Any]]:
        began = time.perf_counter_ns()
        for _ in range(count):
            await client.client.write_values(nodes, values)
            found = await client.client.read_values(nodes)
        return (time.perf_counter_ns() - began) / count, found

    def measure(count: int) -> Mapping[str, float]:
        nonlocal turn
        turn += 1.0
        spent, found = client.run(work(count, [client.value(turn, "Double")] * len(nodes)))
        _check(found == [turn] * len(nodes))
        return {"asyncua": spent}

    return measure


def render(data: Mapping[str, Any]) -> Page:
    """Return the page; see :class:`rosplc_bench.report.Section`."""
    payload, topics = _medians(data["payload"], "size"), _medians(data["topics"], "topics")
    title = "Time for one message in one direction"
    one_way = _table(f"{title}, by message size, µs", "size", PAYLOAD_NAMES, payload, _microseconds)
    by_number = "Messages per second by number of topics (a Twist each)"
    waits = "only Modbus and OPC UA wait for responses"
    sizes, numbers = (
        _series(PAYLOAD_NAMES, payload, _microseconds),
        _series(TOPIC_NAMES, topics, _per_second),
    )
    many = f"Messages per second by number of topics ({waits})"
    return Page(
        lead=paragraphs("sweeps lead"),
        tables=(one_way, _table(by_number, "topics", TOPIC_NAMES, topics, _per_second)),
        figures=(
            Figure("sweep-payload", f"{title} ({waits})", "bytes", "µs", sizes, "lines", True, True),
            Figure("sweep-topics", many, "topics", "messages per second", numbers, "lines", True, True),
        ),
        after=paragraphs("sweeps after", most=data["server_most"]),
        summary=_summary(payload, topics),
    )


def _microseconds(_size: float, ns: float) -> float:
    return ns / 1000


def _per_second(count: float, ns: float) -> float:
    return count / ns * 1e9


def _medians(entries: list[Mapping[str, Any]], key: str) -> dict[str, dict[int, float]]:
    found: dict[str, dict[int, float]] = {}
    for one in entries:
        found.setdefault(one["contender"], {})[one[key]] = statistics.median(one["ns"])
    return found


def _series(names: Mapping[str, str], found: Medians, y: Scale) -> tuple[Series, ...]:
    return tuple(
        Series(
            name,
            tuple(map(float, found[key])),
            tuple(y(x, ns) for x, ns in found[key].items()),
            "rosplc" if key.startswith("rosplc") else "",
        )
        for key, name in names.items()
        if key in found
    )


def _table(title: str, first: str, names: Mapping[str, str], found: Medians, y: Scale) -> Table:
    shown = {name: found[key] for key, name in names.items() if key in found}
    points = sorted({x for values in shown.values() for x in values})
    rows: list[tuple[Cell, ...]] = [
        (
            size_text(x) if first == "size" else x,
            *(y(x, values[x]) if x in values else None for values in shown.values()),
        )
        for x in points
    ]
    note = text("sweeps payload" if first == "size" else "sweeps topics")
    return Table(title, (first, *shown), tuple(rows), text("sweeps waiting"), note)


def _summary(payload: Medians, topics: Medians) -> tuple[str, ...]:
    lines = []
    if "rosplc" in payload and "memcpy" in payload:
        size = max(payload["rosplc"])
        ratio = payload["rosplc"][size] / payload["memcpy"][size]
        lines.append(f"{size_text(size)} through rosplc takes {ratio:.2f} times as long as memcpy both ways.")
    batched, single = topics.get("rosplc-batched"), topics.get("rosplc-single")
    if batched and single:
        most = max(batched)
        lines.append(
            f"{most} topics from Python: {most / batched[most] * 1e3:.2f} million messages per second "
            f"in one call for all, {most / single[most] * 1e3:.2f} one by one."
        )
    return tuple(lines)


SECTION = Section(
    name="sweeps",
    title="By size of the message, and by number of topics",
    question="At what message size does copying begin to matter, and how many topics can be carried?",
    run=run,
    render=render,
    contenders=tuple(dict.fromkeys((*PAYLOAD_NAMES, *TOPIC_NAMES))),
)


def main() -> None:
    """Serve until the input ends: all registers, or a node for bytes and one for each number of a topic."""
    logging.disable(logging.WARNING)
    port, topics = int(sys.argv[2]), int(sys.argv[3])
    if sys.argv[1] == "modbus":
        serve_modbus(port, _MODBUS_MOST // 2)
    else:
        numbers = [f"{topic}.{field}" for topic in range(topics) for field in range(FIELDS)]
        variables = [Variable(name, "Double", 0.0) for name in numbers]
        serve_opcua(port, [Variable("payload", "ByteString", b""), *variables], _START_SECONDS)
    reply(ready=True)
    for _ in requests():
        pass


if __name__ == "__main__":
    main()
