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
from rosplc.web.application import make_application

if TYPE_CHECKING:
    from rosplc.monitor.watch import Watch
    from rosplc.web.settings import Settings

__all__ = ["serve"]

_SHUTDOWN_SECONDS = 2.0


def serve(
    settings: Settings,
    watch: Watch,
    *,
    bind: str,
    port: int,
    ready: Callable[[str, int], None],
) -> None:
    """Serve the page until SIGINT or SIGTERM.

    Args:
        settings: What the server was told.
        watch: What it looks with; closed at the end.
        bind: The address to listen at.
        port: The port; 0 takes a free one.
        ready: Called with address and port once the page can be opened.

    Raises:
        WebError: WEB001, the address cannot be listened at.
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
    settings: Settings,
    watch: Watch,
    listener: socket.socket,
    ready: Callable[[str, int], None],
) -> None:
    ended = asyncio.Event()
    loop = asyncio.get_running_loop()
    for number in (signal.SIGINT, signal.SIGTERM):
        loop.add_signal_handler(number, ended.set)
    application = make_application(settings, watch, socket.gethostname())
    runner = web.AppRunner(application, access_log=None, shutdown_timeout=_SHUTDOWN_SECONDS)
    await runner.setup()
    try:
        await web.SockSite(runner, listener).start()
        address, port = listener.getsockname()[:2]
        ready(address, port)
        await ended.wait()
    finally:
        await runner.cleanup()
