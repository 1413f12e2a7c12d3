"""The processes of the end-to-end comparison, and their messages.

    python -m rosplc_bench.end_to_end_sides ros|plc|bridge JSON [METHOD]

``ros`` is an ordinary DDS participant: it sends messages, and judges what comes back. ``plc`` is a cyclic
task that copies what it sees back. ``bridge`` is what the users of a method write: rosplc's is the one that
``rosplc run`` starts; the other two are a ROS node with a client. Everything in a message follows from its
number, so that a receiver can tell whether all pieces belong to the same message, and what the way has done
to strings and 64-bit numbers.
"""

from __future__ import annotations

import asyncio
import contextlib
import json
import logging
import math
import random
import struct
import sys
import threading
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, Protocol

from rosplc.codec import Codec, Wire
from rosplc.layout import Limits, compute_layout
from rosplc.model import TypeStore
from rosplc.ros import Backend, Qos, open_backend
from rosplc.virtual_plc import ReadBlock, Task, WriteBlock
from rosplc_bench.process import reply, requests
from rosplc_bench.protocols import ModbusClient, OpcUaClient, Variable, serve_modbus, serve_opcua

_LIMIT = 50_000  # a float32 still tells numbers below this apart, with the fraction beside them


@dataclass(frozen=True, slots=True)
class Judgement:
    """What a received message tells of its way.

    Attributes:
        number: Its number; 0 if it is torn, or nothing has been written yet.
        torn: Whether its pieces belong to different messages.
        error: The largest deviation of a floating-point value from what was sent, in units of that value
            (1e-7: the seventh digit); 0.0 for a torn message.
        strings: Strings that arrived as they were sent.
    """

    number: int
    torn: bool
    error: float = 0.0
    strings: int = 0


@dataclass(frozen=True, slots=True)
class Kind:
    """One message type with what fills it.

    Attributes:
        name: Short, for topics and tables.
        type_name: ``package/msg/Name``.
        paths: Every leaf in the type's order, ``pose.position.x``; an array is one leaf.
        length: Elements of each array; 0 where the type has none.
    """

    name: str
    type_name: str
    paths: tuple[str, ...]
    length: int = 0

    def leaf(self, path: str, number: int) -> Any:
        """Return what message ``number`` holds at ``path``."""
        last = _last(path)
        if last in _WORDS:
            named = [f"joint_{index}" for index in range(self.length)]
            return {"frame_id": f"frame {number}", "sec": number, "nanosec": number * 1000, "name": named}[
                last
            ]
        place = self.paths.index(path)
        if self.length:
            return [number + _fraction(place * self.length + index) for index in range(self.length)]
        return number + _fraction(place)

    def leaves(self, number: int) -> list[Any]:
        """Return all leaves of message ``number``, in the order of :attr:`paths`."""
        if not 0 < number < _LIMIT:
            raise ValueError(f"message numbers go from 1 to {_LIMIT - 1}, not {number}")
        return [self.leaf(path, number) for path in self.paths]

    def tree(self, leaves: Sequence[Any]) -> dict[str, Any]:
        """Return leaves as the nested dict that a layout packs."""
        tree: dict[str, Any] = {}
        for path, value in zip(self.paths, leaves, strict=True):
            *parents, last = path.split(".")
            node = tree
            for parent in parents:
                node = node.setdefault(parent, {})
            node[last] = value
        return tree

    def read(self, message: Any) -> list[Any]:
        """Return the leaves of a message (attribute access, as a record view gives it)."""
        leaves = []
        for path in self.paths:
            value = message
            for part in path.split("."):
                value = getattr(value, part)
            leaves.append(value if isinstance(value, (int, float, str)) else list(value))
        return leaves

    def judge(self, leaves: Sequence[Any]) -> Judgement:
        """Say whether leaves belong together, and what they lost; a leaf that was not carried is None."""
        numbers: set[int] = set()
        for path, value in zip(self.paths, leaves, strict=True):
            numbers.update(_numbers(path, value))
        if len(numbers) != 1:
            return Judgement(0, True)
        number = numbers.pop()
        if number == 0:
            return Judgement(0, False)
        error, strings = 0.0, 0
        for path, value in zip(self.paths, leaves, strict=True):
            sent = self.leaf(path, number)
            if isinstance(sent, str) or path == "name":
                strings += _equal_strings(sent, value)
            elif value is not None:
                error = max(error, _error(sent, value))
        return Judgement(number, False, error, strings)

    def strings(self) -> int:
        """Return how many strings a message has."""
        return sum(self.length if path == "name" else path.endswith("frame_id") for path in self.paths)


_WORDS = {"sec": "Int32", "nanosec": "UInt32", "frame_id": "String", "name": "String"}
"""Leaves that are no floating-point numbers, with their OPC UA types."""
_STRINGS = ("frame_id", "name")


def _last(path: str) -> str:
    return path.rpartition(".")[2]


def _fraction(place: int) -> float:
    """Return a fraction that no float32 holds, different at each place, away from 0 and 1."""
    return 0.1 + 0.8 * ((place * 0.6180339887498949) % 1.0)


def _numbers(path: str, value: Any) -> set[int]:
    """Return the message numbers that a leaf speaks of; empty if it carries none."""
    last = _last(path)
    if value is None or last == "name":
        return set()
    if last == "frame_id":
        words = value.split()
        return {int(words[1])} if len(words) == 2 else set()
    if last in _WORDS:
        return {int(value) // (1000 if last == "nanosec" else 1)}
    return {math.floor(item) for item in (value if isinstance(value, (list, tuple)) else (value,))}


def _equal_strings(sent: Any, value: Any) -> int:
    if value is None:
        return 0
    if isinstance(sent, str):
        return int(sent == value)
    return sum(one == other for one, other in zip(sent, value, strict=False))


def _error(sent: Any, value: Any) -> float:
    if isinstance(sent, list):
        if len(sent) != len(value):
            return math.inf
        return max((_error(one, other) for one, other in zip(sent, value, strict=True)), default=0.0)
    return float(abs(value - sent) / abs(sent))


_STAMP = ("header.stamp.sec", "header.stamp.nanosec", "header.frame_id")
_TWIST = tuple(f"{part}.{axis}" for part in ("linear", "angular") for axis in "xyz")
_POSE = (*(f"pose.position.{axis}" for axis in "xyz"), *(f"pose.orientation.{axis}" for axis in "xyzw"))
_JOINTS = (*_STAMP, "name", "position", "velocity", "effort")

KINDS: Mapping[str, Kind] = {
    kind.name: kind
    for kind in (
        Kind("Twist", "geometry_msgs/msg/Twist", _TWIST),
        Kind("PoseStamped", "geometry_msgs/msg/PoseStamped", (*_STAMP, *_POSE)),
        Kind("JointState6", "sensor_msgs/msg/JointState", _JOINTS, 6),
        Kind("JointState24", "sensor_msgs/msg/JointState", _JOINTS, 24),
    )
}
"""The types compared, by name; JointState of an arm, and of a robot with two arms and hands."""


# Modbus registers: two per number, most significant word first. A register has 16 bits, a REAL takes two: a
# 64-bit float is rounded to a 32-bit one, and a string has no place.


def _format(kind: Kind) -> str:
    formats = {"sec": "i", "nanosec": "I"} | dict.fromkeys(_STRINGS, "")
    return ">" + "".join(formats.get(_last(path), f"{kind.length or 1}f") for path in kind.paths)


def pack_registers(kind: Kind, leaves: Sequence[Any]) -> list[int]:
    """Return the registers of a message."""
    numbers: list[Any] = []
    for path, value in zip(kind.paths, leaves, strict=True):
        if _last(path) not in _STRINGS:
            numbers.extend(value if isinstance(value, list) else (value,))
    data = struct.pack(_format(kind), *numbers)
    return list(struct.unpack(f">{len(data) // 2}H", data))


def unpack_registers(kind: Kind, registers: Sequence[int]) -> list[Any]:
    """Return the leaves of a message; None for what registers do not carry."""
    data = struct.pack(f">{len(registers)}H", *registers)
    numbers = iter(struct.unpack(_format(kind), data))
    leaves: list[Any] = []
    for last in map(_last, kind.paths):
        if last in _STRINGS:
            leaves.append(None)
        elif kind.length and last not in _WORDS:
            leaves.append([next(numbers) for _ in range(kind.length)])
        else:
            leaves.append(next(numbers))
    return leaves


def register_count(kind: Kind) -> int:
    """Return the number of registers of a message."""
    return struct.calcsize(_format(kind)) // 2


DISTRO = "jazzy"
LIMITS = Limits(string=32, sequence=24)
QOS = Qos(reliability="reliable", durability="volatile", depth=1000)
_GRACE_S = 5.0
_LOST_S = 1.0


def topics(method: str, kind: str) -> tuple[str, str]:
    """Return the topics to the PLC and back."""
    return f"/e2e/{method}/{kind}/to_plc", f"/e2e/{method}/{kind}/to_ros"


class Translator:
    """A type's leaves to CDR and back."""

    def __init__(self, store: TypeStore, kind: Kind) -> None:
        self.kind = kind
        self._layout = compute_layout(store, kind.type_name, LIMITS)
        self._codec = Codec(self._layout, Wire.CDR)

    def encode(self, leaves: list[Any]) -> bytes:
        """Return a message."""
        return self._codec.encode(self._layout.pack(self.kind.tree(leaves)))

    def decode(self, data: bytes) -> list[Any]:
        """Return a message's leaves."""
        return self.kind.read(self._layout.view(self._codec.decode(data)))


class Line:
    """One method with one type: a publisher, a subscription, and what came back."""

    def __init__(self, backend: Backend, store: TypeStore, method: str, kind: Kind) -> None:
        forth, back = topics(method, kind.name)
        self._kind = kind
        self._translator = Translator(store, kind)
        self._publisher = backend.advertise(forth, kind.type_name, QOS)
        self._subscription = backend.subscribe(back, kind.type_name, QOS, self._on_message)
        self._number = 0
        self._sent: dict[int, int] = {}
        self._came: dict[int, float] = {}
        self._judgements: list[Judgement] = []
        self._news = threading.Condition()

    @property
    def ready(self) -> bool:
        """Whether both ends of the way are connected."""
        return bool(self._publisher.matched and self._subscription.matched)

    def _on_message(self, data: bytes, _stamp_ns: int) -> None:
        now = time.monotonic_ns()
        judgement = self._kind.judge(self._translator.decode(data))
        with self._news:
            self._judgements.append(judgement)
            sent = self._sent.get(judgement.number)
            if sent is not None and judgement.number not in self._came:
                self._came[judgement.number] = (now - sent) / 1000
                self._news.notify()

    def _send(self) -> int:
        self._number += 1
        payload = self._translator.encode(self._kind.leaves(self._number))
        self._sent[self._number] = time.monotonic_ns()
        self._publisher.write(payload)
        return self._number

    def _wait(self, number: int, seconds: float) -> bool:
        with self._news:
            return self._news.wait_for(lambda: number in self._came, seconds)

    def stream(self, count: int, rate: float) -> dict[str, Any]:
        """Send ``count`` messages at ``rate`` (Hz), whatever comes back; report."""
        self._begin()
        began = due = time.monotonic()
        number = 0
        for _ in range(count):
            number = self._send()
            # A fixed period would keep one phase to the PLC's cycle for the whole run.
            due += random.uniform(0.7, 1.3) / rate
            time.sleep(max(0.0, due - time.monotonic()))
        seconds = time.monotonic() - began
        self._wait(number, _GRACE_S)
        return {"sent": count, "seconds": seconds, **self._report()}

    def ping_pong(self, seconds: float) -> dict[str, Any]:
        """Send the next message as soon as the one before is back, for some time; report."""
        self._begin()
        began = time.monotonic()
        sent = 0
        while time.monotonic() - began < seconds:
            sent += 1
            self._wait(self._send(), _LOST_S)
        return {"sent": sent, "seconds": time.monotonic() - began, **self._report()}

    def _begin(self) -> None:
        with self._news:
            self._sent, self._came, self._judgements = {}, {}, []

    def _report(self) -> dict[str, Any]:
        with self._news:
            whole = [one for one in self._judgements if not one.torn and one.number in self._sent]
            return {
                "latencies_us": list(self._came.values()),
                "received": len(self._judgements),
                "torn": sum(one.torn for one in self._judgements),
                "error": max((one.error for one in whole), default=0.0),
                "strings": min((one.strings for one in whole), default=0),
            }


_SWITCH_S = 50e-6


class PlcSide(Protocol):
    """A method as the PLC program meets it."""

    def read(self, kind: Kind) -> Sequence[Any] | None:
        """Return the leaves that the variables hold now; None if there is nothing to see."""

    def write(self, kind: Kind, leaves: Sequence[Any]) -> None:
        """Set the variables that go back."""

    def clear(self, kind: Kind) -> None:
        """Forget what the variables held, before another type is carried."""


class Rosplc:
    """Generated blocks, in their Python form."""

    def __init__(self, place: tuple[str, str]) -> None:
        prefix, directory = place
        ways = {name: topics("rosplc", name) for name in KINDS}
        read = partial(ReadBlock, prefix=prefix, directory=directory)
        write = partial(WriteBlock, prefix=prefix, directory=directory)
        self._reads = {name: read(forth) for name, (forth, _) in ways.items()}
        self._writes = {name: write(back) for name, (_, back) in ways.items()}

    def read(self, kind: Kind) -> Sequence[Any] | None:
        """Call the Read block."""
        block = self._reads[kind.name]
        write = self._writes[kind.name]
        if not write.xReady:
            write()
        return kind.read(block.msg) if block() else None

    def write(self, kind: Kind, leaves: Sequence[Any]) -> None:
        """Fill and call the Write block."""
        block = self._writes[kind.name]
        block.msg.update(kind.tree(leaves))
        block.xEnable = True
        block()
        block.xEnable = False

    def clear(self, kind: Kind) -> None:
        """Each type has blocks of its own."""


class Modbus:
    """Holding registers of a Modbus TCP slave: inputs from 0, outputs from 1000."""

    OUTPUTS = 1000

    def __init__(self, port: int) -> None:
        self._image = [0] * (2 * self.OUTPUTS)

        async def transfer(
            _function: int, _start: int, address: int, count: int, current: list[int], values: Any
        ) -> None:
            # One request is one slice: more than the protocol promises, and the best a slave can do.
            if values is None:
                current[address : address + count] = self._image[address : address + count]
            else:
                self._image[address : address + count] = values

        serve_modbus(port, 2 * self.OUTPUTS, transfer)

    def read(self, kind: Kind) -> Sequence[Any] | None:
        """Look at the registers."""
        return unpack_registers(kind, self._image[: register_count(kind)])

    def write(self, kind: Kind, leaves: Sequence[Any]) -> None:
        """Set the registers."""
        values = pack_registers(kind, leaves)
        self._image[self.OUTPUTS : self.OUTPUTS + len(values)] = values

    def clear(self, kind: Kind) -> None:
        """All types share the registers."""
        self._image[:] = [0] * len(self._image)


class OpcUa:
    """One node per field, as a symbol configuration gives them; arrays are one node."""

    def __init__(self, port: int) -> None:
        # The PLC's variables: [direction][kind][index of the leaf]
        self._image = {
            way: {name: list(_zero(kind)) for name, kind in KINDS.items()} for way in ("to_plc", "to_ros")
        }
        serve_opcua(
            port,
            [
                Variable(f"{way}.{name}.{path}", variant_name(path), values[name][index], values[name], index)
                for way, values in self._image.items()
                for name, kind in KINDS.items()
                for index, path in enumerate(kind.paths)
            ],
        )

    def read(self, kind: Kind) -> Sequence[Any] | None:
        """Copy the variables, one after the other, as a program does."""
        return [value for value in self._image["to_plc"][kind.name]]  # noqa: C416 - one load each

    def write(self, kind: Kind, leaves: Sequence[Any]) -> None:
        """Set the variables, one after the other."""
        values = self._image["to_ros"][kind.name]
        for index, leaf in enumerate(leaves):
            values[index] = leaf

    def clear(self, kind: Kind) -> None:
        """Set this type's variables to zero."""
        for way in self._image.values():
            way[kind.name][:] = _zero(kind)


def variant_name(path: str) -> str:
    """Return the OPC UA type of a leaf."""
    return _WORDS.get(_last(path), "Double")


def _zero(kind: Kind) -> list[Any]:
    zeros: dict[str, Any] = {"sec": 0, "nanosec": 0, "frame_id": "", "name": [""] * kind.length}
    number: Any = [0.0] * kind.length if kind.length else 0.0
    return [zeros.get(_last(path), number) for path in kind.paths]


class Program:
    """Copies back what it sees, and keeps count of it."""

    def __init__(self, side: PlcSide) -> None:
        self._side = side
        self._before: Sequence[Any] | None = None
        self.kind = KINDS["Twist"]
        self.seen = self.torn = 0

    def use(self, kind: Kind) -> None:
        """Go over to another message type, and count from 0."""
        self._side.clear(kind)
        self.kind = kind
        self.seen = self.torn = 0
        self._before = None

    def __call__(self) -> None:
        """Run one scan."""
        kind = self.kind
        leaves = self._side.read(kind)
        if leaves is None or leaves == self._before:
            return
        self._before = leaves
        judgement = kind.judge(leaves)
        if not judgement.torn and judgement.number == 0:
            return
        self._side.write(kind, leaves)
        self.seen += 1
        self.torn += judgement.torn


_POLL_S = 0.001


class Node:
    """The ROS half of a bridge written by hand: the newest message of the type in use, and a way back."""

    def __init__(self, method: str, domain: int) -> None:
        store = TypeStore.bundled(DISTRO)
        self._backend = open_backend("dds", store, f"bench_{method}", domain=domain)
        self._translators = {name: Translator(store, kind) for name, kind in KINDS.items()}
        self._publishers = {}
        for name, kind in KINDS.items():
            forth, back = topics(method, name)
            self._backend.subscribe(forth, kind.type_name, QOS, self._receiver(name))
            self._publishers[name] = self._backend.advertise(back, kind.type_name, QOS)
        self._lock = threading.Lock()
        self._newest: tuple[str, bytes] | None = None
        self._before: Any = None
        self.kind = KINDS["Twist"]
        self.on_news: Callable[[], None] = lambda: None

    def _receiver(self, name: str) -> Callable[[bytes, int], None]:
        def on_message(data: bytes, _stamp_ns: int) -> None:
            with self._lock:
                self._newest = (name, data)
            self.on_news()

        return on_message

    def take(self) -> tuple[Kind, list[Any]] | None:
        """Return the newest message that has arrived, once."""
        with self._lock:
            newest, self._newest = self._newest, None
        return None if newest is None else (KINDS[newest[0]], self._translators[newest[0]].decode(newest[1]))

    def give(self, kind: Kind, leaves: list[Any]) -> None:
        """Publish what the PLC holds, if it is not what it held before."""
        if leaves == self._before:
            return
        self._before = leaves
        judgement = kind.judge(leaves)
        if judgement.number == 0 and not judgement.torn:
            return  # nothing has been written yet
        self._publishers[kind.name].write(self._translators[kind.name].encode(_filled(kind, leaves)))


def _filled(kind: Kind, leaves: list[Any]) -> list[Any]:
    """Put something in place of what was not carried."""
    return [zero if value is None else value for zero, value in zip(_zero(kind), leaves, strict=True)]


def modbus(node: Node, port: int, stop: threading.Event, ready: Callable[[], None]) -> None:
    """Carry over Modbus TCP: requests of at most 123 and 125 registers."""
    client = ModbusClient(port)
    news = threading.Event()
    node.on_news = news.set
    ready()
    while not stop.is_set():
        news.wait(_POLL_S)
        news.clear()
        message = node.take()
        if message is not None:
            client.write(0, pack_registers(*message))
        kind = node.kind
        node.give(kind, unpack_registers(kind, client.read(Modbus.OUTPUTS, register_count(kind))))
    client.close()


def opcua(node: Node, port: int, stop: threading.Event, ready: Callable[[], None]) -> None:
    """Carry over OPC UA: one Write and one Read of all nodes of a message."""
    opcua = OpcUaClient(port)
    nodes = {
        (way, name): [opcua.node(f"{way}.{name}.{path}") for path in kind.paths]
        for way in ("to_plc", "to_ros")
        for name, kind in KINDS.items()
    }
    types = {name: [variant_name(path) for path in kind.paths] for name, kind in KINDS.items()}

    async def carry() -> None:
        news = asyncio.Event()
        loop = asyncio.get_running_loop()

        def wake() -> None:
            loop.call_soon_threadsafe(news.set)

        node.on_news = wake
        ready()
        while not stop.is_set():
            with contextlib.suppress(asyncio.TimeoutError):
                await asyncio.wait_for(news.wait(), _POLL_S)
            news.clear()
            message = node.take()
            if message is not None:
                kind, leaves = message
                values = map(opcua.value, leaves, types[kind.name])
                await opcua.client.write_values(nodes["to_plc", kind.name], list(values))
            kind = node.kind
            node.give(kind, await opcua.client.read_values(nodes["to_ros", kind.name]))

    opcua.run(carry(), None)
    opcua.close()


def rosplc_bridge(plan: dict[str, Any]) -> None:
    """Run rosplc's own bridge, which carries all types at once."""
    from rosplc.bridge.engine import Bridge
    from rosplc.config.resolve import load_project

    with Bridge(load_project(Path(plan["configuration"]))):
        reply(ready=True)
        for _ in requests():
            reply()


def run_ros(plan: dict[str, Any], _method: str) -> None:
    """Run the ROS side; a request names a method and a kind, and what to do."""
    store = TypeStore.bundled(DISTRO)
    backend = open_backend("dds", store, "bench_robot", domain=plan["domain"])
    lines = {
        (method, name): Line(backend, store, method, KINDS[name])
        for method in plan["methods"]
        for name in plan["kinds"]
    }
    reply(ready=True)
    for request in requests():
        if request["do"] == "ready":
            reply(missing=[" ".join(key) for key, line in lines.items() if not line.ready])
            continue
        line = lines[request["method"], request["kind"]]
        if request["do"] == "stream":
            reply(**line.stream(request["count"], request["rate"]))
        else:
            reply(**line.ping_pong(request["seconds"]))
    backend.close()


def run_plc(plan: dict[str, Any], method: str) -> None:
    """Run the PLC; the request ``kind`` begins with a type, anything else asks for the counts."""
    logging.disable(logging.WARNING)
    sys.setswitchinterval(_SWITCH_S)
    sides: dict[str, Callable[[Any], PlcSide]] = {"rosplc": Rosplc, "modbus": Modbus, "opcua": OpcUa}
    program = Program(sides[method](plan["where"]))
    task = Task("RosTask", plan["cycle"], programs=[program])
    task.start()
    reply(ready=True)
    for request in requests():
        if "kind" in request:
            program.use(KINDS[request["kind"]])
        if task.error is not None:
            raise task.error
        reply(seen=program.seen, torn=program.torn, late_us=task.stats.to_dict())
    task.stop()


def run_bridge(plan: dict[str, Any], method: str) -> None:
    """Run a bridge; the request ``kind`` chooses the type that it carries."""
    if method == "rosplc":
        rosplc_bridge(plan)
        return
    logging.disable(logging.WARNING)
    node, stop = Node(method, plan["domain"]), threading.Event()
    failed: list[BaseException] = []
    connected = threading.Event()

    def run() -> None:
        try:
            {"modbus": modbus, "opcua": opcua}[method](node, plan["where"], stop, connected.set)
        except BaseException as error:
            failed.append(error)
            connected.set()

    worker = threading.Thread(target=run, daemon=True)
    worker.start()
    connected.wait()
    if not failed:
        reply(ready=True)
        for request in requests():
            node.kind = KINDS[request["kind"]]
            if failed:
                break
            reply()
    if failed:
        raise failed[0]
    stop.set()
    worker.join(2)


if __name__ == "__main__":
    role, what, *method_name = sys.argv[1:]
    roles = {"ros": run_ros, "plc": run_plc, "bridge": run_bridge}
    roles[role](json.loads(what), "".join(method_name))
