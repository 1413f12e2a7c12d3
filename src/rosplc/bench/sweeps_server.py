"""The servers of the sweeps that are written in Python.

python -m rosplc.bench.sweeps_server modbus|opcua PORT TOPICS
"""

from __future__ import annotations

import asyncio
import logging
import sys
from collections.abc import Callable

from rosplc.bench.end_to_end_child import in_background, orders, say

__all__ = ["FIELDS", "REGISTERS", "START_SECONDS", "URN", "main"]

REGISTERS = 65536
FIELDS = 6
"""Numbers of a topic: those of a Twist."""
URN = "urn:rosplc:sweeps"
START_SECONDS = 300.0
"""asyncua makes some hundred nodes per second, on a small board tens; there are 6,000 in a full run."""


async def modbus(port: int, _topics: int, ready: Callable[[], None]) -> None:
    """Serve all registers that Modbus can address."""
    from pymodbus.server import ModbusTcpServer
    from pymodbus.simulator import DataType, SimData, SimDevice

    device = SimDevice(1, simdata=[SimData(0, count=REGISTERS, values=0, datatype=DataType.REGISTERS)])
    server = ModbusTcpServer(context=device, address=("127.0.0.1", port))
    await server.serve_forever(background=True)
    ready()
    await asyncio.Event().wait()


async def opcua(port: int, topics: int, ready: Callable[[], None]) -> None:
    """Serve a node for bytes, and one for each number of each topic."""
    from asyncua import Server, ua

    server = Server()
    await server.init()
    server.set_endpoint(f"opc.tcp://127.0.0.1:{port}/")
    server.set_security_policy([ua.SecurityPolicyType.NoSecurity])
    space = await server.register_namespace(URN)
    objects = server.nodes.objects
    names = ["payload", *(f"{topic}.{field}" for topic in range(topics) for field in range(FIELDS))]
    for name in names:
        value = b"" if name == "payload" else 0.0
        kind = ua.VariantType.ByteString if name == "payload" else ua.VariantType.Double
        node = await objects.add_variable(ua.NodeId(name, space), f"{space}:{name}", value, kind)
        await node.set_writable()
    async with server:
        ready()
        await asyncio.Event().wait()


def main() -> None:
    """Serve until the input ends."""
    logging.disable(logging.WARNING)
    serve = {"modbus": modbus, "opcua": opcua}[sys.argv[1]]
    port, topics = int(sys.argv[2]), int(sys.argv[3])
    in_background(lambda ready: serve(port, topics, ready), START_SECONDS)
    say(ready=True)
    for _ in orders():
        pass


if __name__ == "__main__":
    main()
