"""OPC UA with asyncua: A writes the array of one node and reads that of another, B is the server."""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Coroutine
from typing import Any

from asyncua import Client, Node, Server, ua
from asyncua.common.callback import CallbackType

from rosplc_bench.peers.exchange import COUNT, ServerLoop, Transport, report, serve
from rosplc_bench.process import free_port
from rosplc_bench.protocols import opcua_server

_QUESTION, _ANSWER = "ns=2;s=question", "ns=2;s=answer"


def _array(values: list[int]) -> ua.DataValue:
    return ua.DataValue(ua.Variant(values, ua.VariantType.UInt16))


class Nodes(Transport):
    """The client.

    Args:
        url: The server's.
    """

    def __init__(self, url: str) -> None:
        super().__init__()
        self._loop = asyncio.new_event_loop()
        self._client = Client(url, timeout=30)
        self._run(self._client.connect())
        self._question = self._client.get_node(_QUESTION)
        self._answer = self._client.get_node(_ANSWER)
        self._seen: list[int] = []

    def _run(self, work: Coroutine[Any, Any, Any]) -> Any:
        return self._loop.run_until_complete(work)

    def send(self, record: bytearray) -> None:
        """Write the question's value."""
        self._run(self._question.write_attribute(ua.AttributeIds.Value, _array(self.values.tolist())))

    def poll(self, record: bytearray) -> bool:
        """Read the answer's value; it is new if it differs."""
        found = self._run(self._answer.read_value())
        if found == self._seen:
            return False
        self._seen = found
        self.values[:] = found
        return True

    def close(self) -> None:
        """Hang up."""
        self._run(self._client.disconnect())
        self._loop.close()


class _Program:
    """B: adds one to what is written into the question."""

    def __init__(self, server: Server, question: Node, answer: Node) -> None:
        self._server = server
        self._question = question
        self._answer = answer
        self._fresh: list[int] | None = None
        self.loop = ServerLoop(self._work)

    async def on_write(self, event: Any, *_: Any) -> None:
        """Note what was written, as asyncua calls it after a write request."""
        (write,) = event.request_params.NodesToWrite
        if write.NodeId != self._question.nodeid:
            return  # the server's own housekeeping
        self._fresh = write.Value.Value.Value
        if not self.loop.cyclic:
            await self._work()

    async def _work(self) -> None:
        if self._fresh is not None:
            values, self._fresh = [value + 1 & 0xFFFF for value in self._fresh], None
            await self._server.write_attribute_value(self._answer.nodeid, _array(values))


async def _serve() -> None:
    port = free_port()
    server, _ = await opcua_server(port)
    zeros = ua.Variant([0] * COUNT, ua.VariantType.UInt16)
    question = await server.nodes.objects.add_variable(_QUESTION, "question", zeros)
    answer = await server.nodes.objects.add_variable(_ANSWER, "answer", zeros)
    await question.set_writable()
    program = _Program(server, question, answer)
    server.subscribe_server_callback(CallbackType.PostWrite, program.on_write)
    async with server:
        report(f"ready opc.tcp://127.0.0.1:{port}/")
        program.loop.listen()
        await program.loop.ended.wait()


def main(side: str, arguments: list[str]) -> None:
    """Arguments: for A the server's URL."""
    logging.disable(logging.CRITICAL)
    if side == "B":
        asyncio.run(_serve())
    else:
        serve(side, Nodes(arguments[0]))
