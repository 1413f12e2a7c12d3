"""Modbus TCP (pymodbus) and OPC UA (asyncua) as the comparisons use them."""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Callable, Iterable, Sequence
from typing import Any, NamedTuple

from rosplc_bench.process import WATCHDOG_S, in_background

URN = "urn:rosplc:bench"
READ_LIMIT = 125
"""Registers that one Modbus request may read (FC03)."""
WRITE_LIMIT = 123
"""Registers that one Modbus request may write (FC16)."""


def serve_modbus(port: int, registers: int, action: Any = None) -> None:
    """Serve holding registers in a thread; ``action`` is pymodbus' callback of an access."""
    from pymodbus.server import ModbusTcpServer
    from pymodbus.simulator import DataType, SimData, SimDevice

    data = [SimData(0, count=registers, values=0, datatype=DataType.REGISTERS)]
    device = SimDevice(1, simdata=data, action=action)

    async def serve(ready: Callable[[], None]) -> None:
        server = ModbusTcpServer(context=device, address=("127.0.0.1", port))
        await server.serve_forever(background=True)
        ready()
        await asyncio.Event().wait()

    in_background(serve)


class ModbusClient:
    """A connected client, whose calls make as many requests as the protocol's limits demand."""

    def __init__(self, port: int) -> None:
        from pymodbus.client import ModbusTcpClient

        self._client = ModbusTcpClient("127.0.0.1", port=port)
        self._client.connect()
        self.close = self._client.close

    def write(self, address: int, values: Sequence[int]) -> None:
        """Write registers from ``address`` on."""
        for begin, end in pieces(len(values), WRITE_LIMIT):
            self._client.write_registers(address + begin, list(values[begin:end]), device_id=1)

    def read(self, address: int, count: int) -> list[int]:
        """Read ``count`` registers from ``address`` on."""
        found: list[int] = []
        for begin, end in pieces(count, READ_LIMIT):
            answer = self._client.read_holding_registers(address + begin, count=end - begin, device_id=1)
            found += answer.registers
        return found


def pieces(count: int, limit: int) -> list[tuple[int, int]]:
    """Return begin and end of each request that moves ``count`` registers, ``limit`` at a time."""
    return [(begin, min(begin + limit, count)) for begin in range(0, count, limit)]


class Variable(NamedTuple):
    """A node of the OPC UA server.

    Attributes:
        name: Its identifier.
        kind: The name of its OPC UA type.
        value: What it holds at first.
        image: The PLC's memory whose element ``place`` it shows and sets; None for a value of its own.
        place: See there.
    """

    name: str
    kind: str
    value: Any
    image: list[Any] | None = None
    place: int = 0


async def add_variable(server: Any, space: int, one: Variable) -> None:
    """Add a node that a client may write."""
    from asyncua import ua

    kind = getattr(ua.VariantType, one.kind)
    node = await server.nodes.objects.add_variable(
        ua.NodeId(one.name, space), f"{space}:{one.name}", one.value, kind
    )
    await node.set_writable()
    if (image := one.image) is None:
        return

    def store(_node: Any, _attribute: Any, value: Any) -> None:
        image[one.place] = value.Value.Value

    def load(*_: Any) -> Any:
        return ua.DataValue(ua.Variant(image[one.place], kind))

    server.set_attribute_value_callback(node.nodeid, load)
    server.set_attribute_value_setter(node.nodeid, store)


async def opcua_server(port: int) -> tuple[Any, int]:
    """Return a server without security that is not yet started, and its name space."""
    from asyncua import Server, ua

    server = Server()
    await server.init()
    server.set_endpoint(f"opc.tcp://127.0.0.1:{port}/")
    server.set_security_policy([ua.SecurityPolicyType.NoSecurity])
    return server, await server.register_namespace(URN)


def serve_opcua(port: int, variables: Iterable[Variable], seconds: float = WATCHDOG_S) -> None:
    """Serve variables in a thread; making its nodes may take ``seconds``."""

    async def serve(ready: Callable[[], None]) -> None:
        server, space = await opcua_server(port)
        for one in variables:
            await add_variable(server, space, one)
        async with server:
            ready()
            await asyncio.Event().wait()

    in_background(serve, seconds)


class OpcUaClient:
    """A client in a thread with an event loop, connected until it is closed."""

    def __init__(self, port: int) -> None:
        self._port = port
        logging.getLogger("asyncua").setLevel(logging.CRITICAL)  # it warns of what is intended here
        self._thread = in_background(self._connect)

    async def _connect(self, ready: Callable[[], None]) -> None:
        from asyncua import Client, ua

        self._loop = asyncio.get_running_loop()
        self._ended = asyncio.Event()
        self.ua = ua
        async with Client(f"opc.tcp://127.0.0.1:{self._port}/") as client:
            self.client = client
            self._space = await client.get_namespace_index(URN)
            ready()
            await self._ended.wait()

    def node(self, name: str) -> Any:
        """Return the node of that identifier."""
        return self.client.get_node(self.ua.NodeId(name, self._space))

    def value(self, value: Any, kind: str) -> Any:
        """Return a value as a node of that type takes it."""
        return self.ua.DataValue(self.ua.Variant(value, getattr(self.ua.VariantType, kind)))

    def run(self, work: Any, seconds: float | None = WATCHDOG_S) -> Any:
        """Run a coroutine in the client's loop and return what it returns."""
        return asyncio.run_coroutine_threadsafe(work, self._loop).result(seconds)

    def close(self) -> None:
        """Disconnect."""
        self._loop.call_soon_threadsafe(self._ended.set)
        self._thread.join(5)
