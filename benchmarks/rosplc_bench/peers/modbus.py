"""Modbus TCP with pymodbus: its synchronous client, its asynchronous server.

Registers 0 to 99 are written (FC16), 100 to 199 are B's answer and are read (FC03).
"""

from __future__ import annotations

import asyncio
import logging

from pymodbus.client import ModbusTcpClient
from pymodbus.server import ModbusTcpServer
from pymodbus.simulator import DataType, SimData, SimDevice

from rosplc_bench.peers.exchange import COUNT, ServerLoop, Transport, report, serve

_WRITE = 16


class Registers(Transport):
    """The client.

    Args:
        port: The server's, on this machine.
    """

    def __init__(self, port: int) -> None:
        super().__init__()
        self._client = ModbusTcpClient("127.0.0.1", port=port, timeout=30)
        if not self._client.connect():
            raise SystemExit(f"no Modbus server at port {port}")
        self._seen = [-1] * COUNT

    def send(self, record: bytearray) -> None:
        """Write 100 registers."""
        answer = self._client.write_registers(0, self.values.tolist())
        if answer.isError():
            raise SystemExit(f"Modbus: {answer}")

    def poll(self, record: bytearray) -> bool:
        """Read 100 registers; they are new if they differ."""
        answer = self._client.read_holding_registers(COUNT, count=COUNT)
        if answer.isError():
            raise SystemExit(f"Modbus: {answer}")
        if answer.registers == self._seen:
            return False
        self._seen = answer.registers
        self.values[:] = answer.registers
        return True

    def close(self) -> None:
        """Hang up."""
        self._client.close()


class _Device:
    """B: the registers, and the program that adds one."""

    def __init__(self) -> None:
        self._registers: list[int] = []
        self._fresh: list[int] | None = None
        self.loop = ServerLoop(self._work)

    async def on_access(
        self,
        function: int,
        start: int,
        address: int,
        count: int,
        registers: list[int],
        written: list[int] | None,
    ) -> None:
        """Note what is written, as pymodbus calls it before it stores."""
        if function == _WRITE and written is not None:
            self._registers = registers
            self._fresh = list(written)
            if not self.loop.cyclic:
                self._work()

    def _work(self) -> None:
        if self._fresh is not None:
            self._registers[COUNT : 2 * COUNT] = [value + 1 & 0xFFFF for value in self._fresh]
            self._fresh = None


async def _serve() -> None:
    device = _Device()
    data = SimData(0, count=2 * COUNT, values=0, datatype=DataType.REGISTERS)
    server = ModbusTcpServer(SimDevice(0, simdata=[data], action=device.on_access), address=("127.0.0.1", 0))
    await server.serve_forever(background=True)
    assert server.transport is not None
    report(f"ready {server.transport.sockets[0].getsockname()[1]}")
    device.loop.listen()
    await device.loop.ended.wait()
    await server.shutdown()


def main(side: str, arguments: list[str]) -> None:
    """Arguments: for A the server's port."""
    logging.disable(logging.CRITICAL)
    if side == "B":
        asyncio.run(_serve())
    else:
        serve(side, Registers(int(arguments[0])))
