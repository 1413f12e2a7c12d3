"""The PLC of the end-to-end comparison: a cyclic task that copies what it sees back.

    python -m rosplc.bench.end_to_end_plc METHOD JSON

The variables of the PLC are there in memory for its task; what stands between them and ROS is the method's
business. With Modbus and OPC UA a server runs beside the task, as in a PLC's runtime, and the task may
interrupt it anywhere, as a task of higher priority does.
"""

from __future__ import annotations

import asyncio
import json
import logging
import sys
from collections.abc import Callable, Sequence
from typing import Any, Protocol

from rosplc.bench import end_to_end_registers as registers
from rosplc.bench.end_to_end_child import in_background, orders, say
from rosplc.bench.end_to_end_messages import KINDS, Kind
from rosplc.virtual_plc import ReadBlock, Task, WriteBlock

__all__ = ["Side", "main"]

_SWITCH_S = 50e-6


class Side(Protocol):
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
        self._reads: dict[str, ReadBlock] = {}
        self._writes: dict[str, WriteBlock] = {}
        for name in KINDS:
            forth, back = f"/e2e/rosplc/{name}/to_plc", f"/e2e/rosplc/{name}/to_ros"
            self._reads[name] = ReadBlock(forth, prefix=prefix, directory=directory)
            self._writes[name] = WriteBlock(back, prefix=prefix, directory=directory)

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
        from pymodbus.server import ModbusTcpServer
        from pymodbus.simulator import DataType, SimData, SimDevice

        self._image = [0] * (2 * self.OUTPUTS)

        async def transfer(
            _function: int, _start: int, address: int, count: int, current: list[int], values: Any
        ) -> None:
            # One request is one slice: more than the protocol promises, and the best a slave can do.
            if values is None:
                current[address : address + count] = self._image[address : address + count]
            else:
                self._image[address : address + count] = values

        device = SimDevice(
            1,
            simdata=[SimData(0, count=2 * self.OUTPUTS, values=0, datatype=DataType.REGISTERS)],
            action=transfer,
        )

        async def serve(ready: Callable[[], None]) -> None:
            server = ModbusTcpServer(context=device, address=("127.0.0.1", port))
            await server.serve_forever(background=True)
            ready()
            await asyncio.Event().wait()

        in_background(serve)

    def read(self, kind: Kind) -> Sequence[Any] | None:
        """Look at the registers."""
        return registers.unpack(kind, self._image[: registers.size(kind)])

    def write(self, kind: Kind, leaves: Sequence[Any]) -> None:
        """Set the registers."""
        values = registers.pack(kind, leaves)
        self._image[self.OUTPUTS : self.OUTPUTS + len(values)] = values

    def clear(self, kind: Kind) -> None:
        """All types share the registers."""
        self._image[:] = [0] * len(self._image)


class OpcUa:
    """One node per field, as a symbol configuration gives them; arrays are one node."""

    def __init__(self, port: int) -> None:
        from asyncua import Server, ua

        # The PLC's variables: [direction][kind][index of the leaf]
        self._image = {
            way: {name: list(_zero(kind)) for name, kind in KINDS.items()} for way in ("to_plc", "to_ros")
        }

        async def add(server: Any, space: int, way: str, kind: Kind, index: int) -> None:
            path, values = kind.paths[index], self._image[way][kind.name]
            variant = getattr(ua.VariantType, variant_name(path))
            node = await server.nodes.objects.add_variable(
                ua.NodeId(f"{way}.{kind.name}.{path}", space), f"{space}:{path}", values[index], variant
            )
            await node.set_writable()
            server.set_attribute_value_callback(
                node.nodeid, lambda *_: ua.DataValue(ua.Variant(values[index], variant))
            )

            def store(_node: Any, _attribute: Any, value: Any) -> None:
                values[index] = value.Value.Value

            server.set_attribute_value_setter(node.nodeid, store)

        async def serve(ready: Callable[[], None]) -> None:
            server = Server()
            await server.init()
            server.set_endpoint(f"opc.tcp://127.0.0.1:{port}/")
            server.set_security_policy([ua.SecurityPolicyType.NoSecurity])
            space = await server.register_namespace("urn:rosplc:bench")
            for way in self._image:
                for kind in KINDS.values():
                    for index in range(len(kind.paths)):
                        await add(server, space, way, kind, index)
            async with server:
                ready()
                await asyncio.Event().wait()

        in_background(serve)

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
    names = {"sec": "Int32", "nanosec": "UInt32", "frame_id": "String", "name": "String"}
    return names.get(path.rpartition(".")[2], "Double")


def _zero(kind: Kind) -> list[Any]:
    zeros: dict[str, Any] = {"sec": 0, "nanosec": 0, "frame_id": "", "name": [""] * kind.length}
    return [
        zeros.get(path.rpartition(".")[2], [0.0] * kind.length if kind.length else 0.0) for path in kind.paths
    ]


class Program:
    """Copies back what it sees, and keeps count of it."""

    def __init__(self, side: Side) -> None:
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


SIDES: dict[str, Callable[[Any], Side]] = {"rosplc": Rosplc, "modbus": Modbus, "opcua": OpcUa}


def main() -> None:
    """Run the PLC; orders: ``kind`` to begin with a type, anything else asks for the counts."""
    logging.disable(logging.WARNING)
    plan = json.loads(sys.argv[2])
    sys.setswitchinterval(_SWITCH_S)
    program = Program(SIDES[sys.argv[1]](plan["where"]))
    task = Task("RosTask", plan["cycle"], programs=[program])
    task.start()
    say(ready=True)
    for order in orders():
        if "kind" in order:
            program.use(KINDS[order["kind"]])
        if task.error is not None:
            raise task.error
        say(seen=program.seen, torn=program.torn, late_us=task.stats.to_dict())
    task.stop()


if __name__ == "__main__":
    main()
