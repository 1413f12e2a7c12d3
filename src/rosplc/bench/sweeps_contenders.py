"""Who takes part in the sweeps: each moves a message one way, or one message on each of many topics.

A contender is a function that takes how often, and returns nanoseconds per message (or per round over all
topics) by name. Each checks what arrived.
"""

from __future__ import annotations

import asyncio
import logging
import secrets
import time
from collections.abc import Callable, Mapping
from contextlib import ExitStack
from pathlib import Path
from typing import Any, TypeAlias

from rosplc.bench.end_to_end_child import WATCHDOG_S, in_background
from rosplc.bench.process import Side
from rosplc.bench.sweeps_server import FIELDS, URN
from rosplc.codec import Codec, Wire
from rosplc.errors import SetupError
from rosplc.layout import Limits, compute_layout
from rosplc.model import TypeStore
from rosplc.shm import Description, Direction, Namespace, OwnedChannel, Reader, Writer

__all__ = [
    "Contender",
    "OpcUaClient",
    "channels",
    "memcpy_python",
    "program",
    "pymodbus_there",
    "pymodbus_there_and_back",
    "rosplc_python",
    "topics_python",
]

Contender: TypeAlias = Callable[[int], Mapping[str, float]]

_EMPTY = "std_msgs/msg/Empty"
TWIST = "geometry_msgs/msg/Twist"
_WRITTEN, _READ = 123, 125


def channels(folder: Path, count: int, size: int, stack: ExitStack) -> list[OwnedChannel]:
    """Make channels for records of ``size`` bytes; they are gone with ``stack``."""
    namespace = Namespace(f"sweep-{secrets.token_hex(4)}", str(folder))
    made = []
    for index in range(count):
        about = Description(
            f"/topic{index}", _EMPTY, "jazzy", Direction.TO_ROS, {}, "0" * 16, "bench", "uint8 x"
        )
        channel = OwnedChannel.open(namespace, about, record_size=size)
        stack.callback(channel.retire)  # the memory is wanted for the next size
        made.append(channel)
    return made


def program(name: str, command: list[str], stack: ExitStack) -> Contender:
    """Return the contenders of a running C program."""
    side = Side(name, command)
    stack.callback(side.close)

    def measure(count: int) -> Mapping[str, float]:
        side.order(str(count))
        found: Mapping[str, float] = side.hear_json(WATCHDOG_S)
        return found

    return measure


def _check(arrived: bool) -> None:
    if not arrived:
        raise SetupError("SYS002", "what arrived is not what was sent")


def rosplc_python(channel: OwnedChannel, size: int) -> Contender:
    """Return the channel from Python: one publication and one taking."""
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
    from rosplc._core._native import Group

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
    return compute_layout(TypeStore.bundled("jazzy"), TWIST, Limits())


def _pymodbus(port: int, registers: int, stack: ExitStack) -> tuple[Callable[[list[int]], None], Any]:
    from pymodbus.client import ModbusTcpClient

    client = ModbusTcpClient("127.0.0.1", port=port)
    client.connect()
    stack.callback(client.close)

    def write(values: list[int]) -> None:
        for at in range(0, registers, _WRITTEN):
            client.write_registers(at, values[at : at + _WRITTEN], device_id=1)

    def read() -> list[int]:
        found: list[int] = []
        for at in range(0, registers, _READ):
            answer = client.read_holding_registers(at, count=min(_READ, registers - at), device_id=1)
            found += answer.registers
        return found

    return write, read


def pymodbus_there(port: int, size: int, stack: ExitStack) -> Contender:
    """Return pymodbus writing ``size`` bytes, in as many requests as it takes."""
    registers = (size + 1) // 2
    write, read = _pymodbus(port, registers, stack)
    turn = 0

    def measure(count: int) -> Mapping[str, float]:
        nonlocal turn
        turn += 1
        values = [turn % 65536] * registers
        began = time.perf_counter_ns()
        for _ in range(count):
            write(values)
        spent = time.perf_counter_ns() - began
        _check(read() == values)
        return {"pymodbus": spent / count}

    return measure


def pymodbus_there_and_back(port: int, topics: int, stack: ExitStack) -> Contender:
    """Return pymodbus writing and reading all topics, two registers per number."""
    registers = topics * FIELDS * 2
    write, read = _pymodbus(port, registers, stack)
    turn = 0

    def measure(count: int) -> Mapping[str, float]:
        nonlocal turn
        turn += 1
        values = [turn % 65536] * registers
        began = time.perf_counter_ns()
        for _ in range(count):
            write(values)
            found = read()
        spent = time.perf_counter_ns() - began
        _check(found == values)
        return {"pymodbus": spent / count}

    return measure


class OpcUaClient:
    """An asyncua client, connected once for all sizes and numbers of topics."""

    def __init__(self, port: int) -> None:
        self._port = port
        self._turn = 0
        logging.getLogger("asyncua").setLevel(logging.CRITICAL)  # it warns of what is as it should be
        self._thread = in_background(self._connect)

    async def _connect(self, ready: Callable[[], None]) -> None:
        from asyncua import Client, ua

        self._loop = asyncio.get_running_loop()
        self._ended = asyncio.Event()
        self._ua = ua
        async with Client(f"opc.tcp://127.0.0.1:{self._port}/") as client:
            self._client = client
            self._space = await client.get_namespace_index(URN)
            ready()
            await self._ended.wait()

    def close(self) -> None:
        """Disconnect."""
        self._loop.call_soon_threadsafe(self._ended.set)
        self._thread.join(5)

    def _wait(self, work: Any) -> Any:
        return asyncio.run_coroutine_threadsafe(work, self._loop).result(WATCHDOG_S)

    def _node(self, name: str) -> Any:
        return self._client.get_node(self._ua.NodeId(name, self._space))

    def payload(self, size: int) -> Contender:
        """Return writing one node of ``size`` bytes."""
        node, ua = self._node("payload"), self._ua

        async def work(count: int, value: Any) -> float:
            began = time.perf_counter_ns()
            for _ in range(count):
                await node.write_value(value)
            return (time.perf_counter_ns() - began) / count

        def measure(count: int) -> Mapping[str, float]:
            self._turn += 1
            content = bytes([self._turn % 256]) * size
            value = ua.DataValue(ua.Variant(content, ua.VariantType.ByteString))
            spent = self._wait(work(count, value))
            _check(self._wait(node.read_value()) == content)
            return {"asyncua": spent}

        return measure

    def topics(self, topics: int) -> Contender:
        """Return writing and reading all nodes of so many topics, in one request each way."""
        ua = self._ua
        nodes = [self._node(f"{topic}.{field}") for topic in range(topics) for field in range(FIELDS)]

        async def work(count: int, values: list[Any]) -> tuple[float, list[Any]]:
            began = time.perf_counter_ns()
            for _ in range(count):
                await self._client.write_values(nodes, values)
                found = await self._client.read_values(nodes)
            return (time.perf_counter_ns() - began) / count, found

        def measure(count: int) -> Mapping[str, float]:
            self._turn += 1
            number = float(self._turn)
            values = [ua.DataValue(ua.Variant(number, ua.VariantType.Double))] * len(nodes)
            spent, found = self._wait(work(count, values))
            _check(found == [number] * len(nodes))
            return {"asyncua": spent}

        return measure
