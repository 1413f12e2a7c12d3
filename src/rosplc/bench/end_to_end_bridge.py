"""The bridges of the end-to-end comparison, each as the people who use that method write it.

    python -m rosplc.bench.end_to_end_bridge METHOD JSON

rosplc's is the one that ``rosplc run`` starts. The other two are a ROS node with a client: a message that
arrives is written at once, and every millisecond, or as fast as the answers come, the node reads what
the PLC has for it and publishes it if it has changed. They carry one type at a time.
"""

from __future__ import annotations

import asyncio
import contextlib
import json
import logging
import sys
import threading
from collections.abc import Callable
from pathlib import Path
from typing import Any

from rosplc.bench import end_to_end_registers as registers
from rosplc.bench.end_to_end_child import orders, say
from rosplc.bench.end_to_end_messages import KINDS, Kind
from rosplc.bench.end_to_end_plc import Modbus, variant_name
from rosplc.bench.end_to_end_ros import DISTRO, QOS, Translator, topics
from rosplc.model import TypeStore
from rosplc.ros import open_backend

__all__ = ["Node", "main"]

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
            self._backend.subscribe(forth, kind.type_name, QOS, self._heard(name))
            self._publishers[name] = self._backend.advertise(back, kind.type_name, QOS)
        self._lock = threading.Lock()
        self._newest: tuple[str, bytes] | None = None
        self._before: Any = None
        self.kind = KINDS["Twist"]
        self.on_news: Callable[[], None] = lambda: None

    def use(self, kind: Kind) -> None:
        """Carry another type from now on."""
        self.kind = kind

    def _heard(self, name: str) -> Callable[[bytes, int], None]:
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
    return [
        value if value is not None else [""] * kind.length if path == "name" else ""
        for path, value in zip(kind.paths, leaves, strict=True)
    ]


def modbus(node: Node, port: int, stop: threading.Event, ready: Callable[[], None]) -> None:
    """Carry over Modbus TCP: requests of at most 123 and 125 registers."""
    from pymodbus.client import ModbusTcpClient

    client = ModbusTcpClient("127.0.0.1", port=port)
    client.connect()
    news = threading.Event()
    node.on_news = news.set
    ready()
    while not stop.is_set():
        news.wait(_POLL_S)
        news.clear()
        message = node.take()
        if message is not None:
            values = registers.pack(*message)
            for begin, end in registers.pieces(len(values), registers.WRITE_LIMIT):
                client.write_registers(begin, values[begin:end], device_id=1)
        kind = node.kind
        found: list[int] = []
        for begin, end in registers.pieces(registers.size(kind), registers.READ_LIMIT):
            answer = client.read_holding_registers(Modbus.OUTPUTS + begin, count=end - begin, device_id=1)
            found += answer.registers
        node.give(kind, registers.unpack(kind, found))
    client.close()


def opcua(node: Node, port: int, stop: threading.Event, ready: Callable[[], None]) -> None:
    """Carry over OPC UA: one Write and one Read of all nodes of a message."""
    from asyncua import Client, ua

    async def carry() -> None:
        async with Client(f"opc.tcp://127.0.0.1:{port}/") as client:
            space = await client.get_namespace_index("urn:rosplc:bench")
            nodes = {
                (way, name): [
                    client.get_node(ua.NodeId(f"{way}.{name}.{path}", space)) for path in kind.paths
                ]
                for way in ("to_plc", "to_ros")
                for name, kind in KINDS.items()
            }
            types = {
                name: [getattr(ua.VariantType, variant_name(path)) for path in kind.paths]
                for name, kind in KINDS.items()
            }
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
                    variants = [
                        ua.DataValue(ua.Variant(leaf, type_))
                        for leaf, type_ in zip(leaves, types[kind.name], strict=True)
                    ]
                    await client.write_values(nodes["to_plc", kind.name], variants)
                kind = node.kind
                node.give(kind, await client.read_values(nodes["to_ros", kind.name]))

    asyncio.run(carry())


def rosplc(plan: dict[str, Any]) -> None:
    """Run rosplc's own bridge, which carries all types at once."""
    from rosplc.bridge.engine import Bridge
    from rosplc.config.resolve import load_project

    with Bridge(load_project(Path(plan["configuration"]))):
        say(ready=True)
        for _ in orders():
            say()


def main() -> None:
    """Run a bridge; the order ``kind`` chooses the type that it carries."""
    method, plan = sys.argv[1], json.loads(sys.argv[2])
    if method == "rosplc":
        rosplc(plan)
        return
    logging.disable(logging.WARNING)
    node = Node(method, plan["domain"])
    stop = threading.Event()
    carry = {"modbus": modbus, "opcua": opcua}[method]
    failed: list[BaseException] = []
    connected = threading.Event()

    def run() -> None:
        try:
            carry(node, plan["where"], stop, connected.set)
        except BaseException as error:
            failed.append(error)
            connected.set()

    worker = threading.Thread(target=run, daemon=True)
    worker.start()
    connected.wait()
    if failed:
        raise failed[0]
    say(ready=True)
    for order in orders():
        node.use(KINDS[order["kind"]])
        if failed:
            raise failed[0]
        say()
    stop.set()
    worker.join(2)


if __name__ == "__main__":
    main()
