"""The server in the foreground: its address, its start and its end."""

from __future__ import annotations

import asyncio
import contextlib
import signal
import socket
from collections.abc import Callable
from typing import TYPE_CHECKING

from aiohttp import web

from rosplc.errors import WebError
from rosplc.web.application import ARRIVED, make_application

if TYPE_CHECKING:
    from rosplc.monitor.watch import Watch
    from rosplc.web.settings import Settings

__all__ = ["MAX_CONNECTIONS", "open_door", "serve"]

_SHUTDOWN_SECONDS = 2.0
_REQUEST_SECONDS = 10.0
"""How long a request's head may take, and how long a connection may wait for its next one."""
MAX_CONNECTIONS = 128
"""Connections at once: far fewer than a process may have files open."""


class _Door(asyncio.Protocol):
    """Lets connections in, and closes those that ask for nothing.

    Without it, connections without a request would use up this process's files, and then the page is shut for
    everybody.

    Args:
        runner: What serves them.
        idle: Connections that have asked for nothing so far, the oldest first.
        seconds: After how long such a connection is closed.
    """

    def __init__(
        self, runner: web.AppRunner, idle: dict[asyncio.BaseTransport, asyncio.TimerHandle], seconds: float
    ) -> None:
        self._runner, self._idle, self._seconds = runner, idle, seconds

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        """Hand the connection on, in the place of an idle one where all places are taken."""
        assert isinstance(transport, asyncio.Transport) and self._runner.server is not None
        for known in [one for one in self._idle if one.is_closing()]:
            self._idle.pop(known).cancel()
        if len(self._runner.server.connections) >= MAX_CONNECTIONS:
            if not self._idle:
                transport.abort()
                return
            oldest = next(iter(self._idle))
            self._idle.pop(oldest).cancel()
            _abort(oldest)
        handler = self._runner.server()
        transport.set_protocol(handler)
        handler.connection_made(transport)
        self._idle[transport] = asyncio.get_running_loop().call_later(self._seconds, self._late, transport)

    def _late(self, transport: asyncio.BaseTransport) -> None:
        if self._idle.pop(transport, None) is not None:
            _abort(transport)


async def open_door(
    runner: web.AppRunner, listener: socket.socket, seconds: float = _REQUEST_SECONDS
) -> asyncio.Server:
    """Serve what connects to a listener, within :data:`MAX_CONNECTIONS`.

    Args:
        runner: What serves it; its application gets the request's mark as ``ARRIVED``.
        listener: Where to listen.
        seconds: How long a connection may take to send a request's head.
    """
    idle: dict[asyncio.BaseTransport, asyncio.TimerHandle] = {}

    def arrived(transport: asyncio.BaseTransport | None) -> None:
        timer = None if transport is None else idle.pop(transport, None)
        if timer is not None:
            timer.cancel()

    runner.app[ARRIVED].append(arrived)
    loop = asyncio.get_running_loop()
    return await loop.create_server(lambda: _Door(runner, idle, seconds), sock=listener)


def _abort(transport: asyncio.BaseTransport) -> None:
    if isinstance(transport, asyncio.Transport):
        transport.abort()


def serve(
    settings: Settings, watch: Watch, *, bind: str, port: int, ready: Callable[[str, int], None]
) -> None:
    """Serve the page until SIGINT or SIGTERM.

    Args:
        settings: What the server was told.
        watch: What it looks with; closed at the end.
        bind: The address to listen at.
        port: The port; 0 takes a free one.
        ready: Called with address and port once the page can be opened.

    Raises:
        WebError: WEB001, it cannot listen on this address.
    """
    listener = _listen(bind, port)
    with contextlib.closing(listener), watch:
        asyncio.run(_serve(settings, watch, listener, ready))


def _listen(bind: str, port: int) -> socket.socket:
    try:
        found = socket.getaddrinfo(bind, port, type=socket.SOCK_STREAM, flags=socket.AI_PASSIVE)
        family, kind, protocol, _, address = found[0]
        listener = socket.socket(family, kind, protocol)
        try:
            listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            listener.bind(address)
            listener.listen(64)
        except BaseException:
            listener.close()
            raise
    except (OSError, OverflowError, UnicodeError) as error:
        reason = getattr(error, "strerror", None) or str(error)
        raise WebError("WEB001", f"cannot listen: {reason}", where=f"{bind}:{port}") from error
    return listener


async def _serve(
    settings: Settings, watch: Watch, listener: socket.socket, ready: Callable[[str, int], None]
) -> None:
    ended = asyncio.Event()
    loop = asyncio.get_running_loop()
    for number in (signal.SIGINT, signal.SIGTERM):
        loop.add_signal_handler(number, ended.set)
    application = make_application(settings, watch, socket.gethostname())
    runner = web.AppRunner(
        application, access_log=None, shutdown_timeout=_SHUTDOWN_SECONDS, keepalive_timeout=_REQUEST_SECONDS
    )
    await runner.setup()
    server: asyncio.Server | None = None
    try:
        server = await open_door(runner, listener)
        address, port = listener.getsockname()[:2]
        ready(address, port)
        await ended.wait()
    finally:
        if server is not None:
            server.close()
        await runner.cleanup()
