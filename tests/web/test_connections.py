"""Connections that ask for nothing: they keep nobody out."""

from __future__ import annotations

import asyncio
import logging
import socket
from contextlib import ExitStack, suppress

import aiohttp
from aiohttp import web

from rosplc.monitor import Watch
from rosplc.web import Settings
from rosplc.web.server import MAX_CONNECTIONS, _listen, make_application, open_door
from tests.web.peers import WATCHDOG


def serve(prefix: str, talk, seconds: float) -> None:
    async def run() -> None:
        with Watch(prefix) as watch:
            runner = web.AppRunner(make_application(Settings(prefix=prefix), watch, "machine"))
            await runner.setup()
            server = await open_door(runner, listener := _listen("127.0.0.1", 0), seconds)
            try:
                await asyncio.wait_for(talk(listener.getsockname()), WATCHDOG)
            finally:
                server.close()
                await runner.cleanup()

    asyncio.run(run())


async def status(address) -> int:
    async with (
        aiohttp.ClientSession() as session,
        session.get(f"http://{address[0]}:{address[1]}/") as answer,
    ):
        return answer.status


def test_idle_connections_keep_nobody_out(shm_namespace, caplog) -> None:
    """However many connections are open without a request, the page answers, and without a traceback."""

    async def talk(address) -> None:
        with ExitStack() as stack:
            for number in range(MAX_CONNECTIONS + 40):
                one = stack.enter_context(socket.create_connection(address))
                one.send(b"GET / HTTP/1.1\r\nHost: loc"[: number % 30])
                await asyncio.sleep(0)
            assert await status(address) == 200

    with caplog.at_level(logging.WARNING):
        serve(shm_namespace.prefix, talk, WATCHDOG)
    assert not caplog.records


def test_half_a_request_is_given_up(shm_namespace) -> None:
    """A connection whose request does not come is closed; one that has asked stays."""

    async def talk(address) -> None:
        half, writer = await asyncio.open_connection(*address)
        writer.write(b"GET / HTTP/1.1\r\n")
        whole, asking = await asyncio.open_connection(*address)
        asking.write(b"GET / HTTP/1.1\r\nHost: localhost\r\n\r\n")
        await whole.readuntil(b"\r\n\r\n")
        with suppress(ConnectionResetError):
            assert await half.read() == b""
        assert not whole.at_eof()
        writer.close()
        asking.close()

    serve(shm_namespace.prefix, talk, 0.2)
