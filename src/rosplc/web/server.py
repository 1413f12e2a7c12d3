"""The HTTP server: the page's files, its data, and the writing of test messages."""

from __future__ import annotations

import asyncio
import contextlib
import json
import logging
import signal
import socket
from collections.abc import AsyncIterator, Callable
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from pathlib import Path
from typing import Any

from aiohttp import web
from aiohttp.typedefs import Handler

from rosplc.described import layout_of
from rosplc.errors import RosplcError, WebError
from rosplc.levels import Level
from rosplc.monitor.picture import Event
from rosplc.monitor.watch import Watch
from rosplc.shm import Namespace, Part
from rosplc.shm import attach as attach_object
from rosplc.web.access import Settings, access, add_headers, bearer, require_token
from rosplc.web.live import Feed, Viewers
from rosplc.web.write import form_of, write_message

_STATIC = Path(__file__).parent / "static"
_log = logging.getLogger("rosplc.web")
_LARGEST_BYTES = 4 * 1024 * 1024
BODY_SECONDS = 10.0  # how long a request's body may take

ARRIVED: web.AppKey[list[Callable[[asyncio.BaseTransport | None], None]]] = web.AppKey("arrived", list)
"""Called with a connection's transport when a request's header has arrived."""


@web.middleware
async def arrival(request: web.Request, handler: Handler) -> web.StreamResponse:
    """Note that a connection has sent a request."""
    for tell in request.app[ARRIVED]:
        tell(request.transport)
    return await handler(request)


def make_application(settings: Settings, watch: Watch, machine: str) -> web.Application:
    """Return the application; it looks at channels until its clean-up. Pages show the name ``machine``."""
    viewers = Viewers(settings, machine)
    api = _Api(settings)

    async def looking(_application: web.Application) -> AsyncIterator[None]:
        # Not earlier: what belongs to an event loop is made in it.
        viewers.feed = api.feed = Feed(watch, viewers.wanted)
        task = asyncio.create_task(viewers.feed.run())
        yield
        task.cancel()
        with contextlib.suppress(asyncio.CancelledError):
            await task

    async def page(_request: web.Request) -> web.FileResponse:
        return web.FileResponse(_STATIC / "index.html")

    application = web.Application(middlewares=[arrival, access(settings)], client_max_size=_LARGEST_BYTES)
    application[ARRIVED] = []
    application.cleanup_ctx.append(looking)
    application.on_shutdown.append(viewers.close)
    application.on_response_prepare.append(add_headers)
    application.add_routes(
        [
            web.get("/", page),
            web.static("/static", _STATIC),
            web.get("/api/live", viewers.handle),
            web.get("/api/status", api.status),
            web.get("/api/form", api.form),
            web.post("/api/token", api.token),
            web.post("/api/write", api.write),
        ]
    )
    return application


class _Api:
    """Requests and responses besides the WebSocket."""

    def __init__(self, settings: Settings) -> None:
        self.feed: Feed
        self._settings = settings
        self._writing = ThreadPoolExecutor(1, thread_name_prefix="rosplc-web-write")

    async def status(self, _request: web.Request) -> web.Response:
        """Respond with the output of ``rosplc status --json``, as of the last look."""
        if self.feed.document is None and not self.feed.failure:
            await self.feed.news()
        return web.json_response(self.feed.document or {})

    async def form(self, request: web.Request) -> web.Response:
        """Respond with a channel's type, as returned by :func:`rosplc.web.write.form_of`."""
        return web.json_response(await self._in_thread(self._form, request.query.get("channel", "")))

    async def token(self, request: web.Request) -> web.Response:
        """Respond whether the request's token is correct."""
        await self._require_token(request)
        return web.json_response({"token": "right"})

    async def write(self, request: web.Request) -> web.Response:
        """Write a test message: ``{"channel": id, "layout": id, "message": {...}, "not_finite": bool}``."""
        if not self._settings.allow_write:
            raise WebError("WEB006", "this server was started read-only")
        await self._require_token(request)
        wish = await _json(request)
        channel, layout, message = wish.get("channel"), wish.get("layout"), wish.get("message")
        if not isinstance(channel, str) or not isinstance(layout, str) or not isinstance(message, dict):
            raise WebError("WEB009", "`channel` and `layout` must be strings, and `message` an object")
        view = self._channel(channel)
        if view["kind"] != "topic":
            raise WebError("WEB008", "only the PLC and ROS nodes can make calls", where=view["label"])
        namespace = Namespace(view["prefix"], self._settings.directory)
        who = f"the page at {request.remote}"
        try:
            write = partial(write_message, not_finite=wish.get("not_finite") is True, clock=self.feed.clock)
            sequence = await self._in_thread(write, namespace, view["topic"], layout, message)
        except RosplcError as error:
            self._note("write-refused", Level.WARN, view, f"{who} cannot write: {error.what} [{error.code}]")
            raise
        self._note("written", Level.OK, view, f"{who} wrote test message number {sequence}")
        return web.json_response({"sequence": sequence})

    def _form(self, channel: str) -> dict[str, Any]:
        view = self._channel(channel)
        namespace = Namespace(view["prefix"], self._settings.directory)
        part = Part[view["part"].upper()]
        with attach_object(namespace, view["topic"], part=part, client=view["client"]) as attached:
            layout = layout_of(attached)
        return {
            "channel": channel,
            "layout": layout.layout_id,
            "form": form_of(layout),
            "initial": layout.to_dict(layout.initial()),
        }

    def _channel(self, channel: str) -> dict[str, Any]:
        view = self.feed.channels.get(channel)
        if view is None:
            raise WebError("WEB008", "this channel does not exist at present", where=channel[:200])
        if view["classic"]:
            raise WebError("WEB008", "a classic topic's memory has no type description", where=view["topic"])
        return view

    async def _require_token(self, request: web.Request) -> None:
        try:
            require_token(self._settings, bearer(request))
        except WebError:
            # Nobody guesses 144 bits; a short token of somebody's own deserves the brake.
            await asyncio.sleep(0.5)
            _log.warning("a request from %s had the wrong token", request.remote)
            raise

    async def _in_thread(self, function: Callable[..., Any], *arguments: Any) -> Any:
        return await asyncio.get_running_loop().run_in_executor(self._writing, function, *arguments)

    def _note(self, kind: str, level: Level, view: dict[str, Any], words: str) -> None:
        _log.log(logging.INFO if level is Level.OK else logging.WARNING, "%s: %s", view["topic"], words)
        now = self.feed.clock.time_ns()
        self.feed.note(Event(now, kind, level, view["id"], view["prefix"], view["topic"], words))


def _refuse_constant(name: str) -> float:
    raise ValueError(f"{name} is not JSON")


async def _json(request: web.Request) -> dict[str, Any]:
    if request.content_type != "application/json":
        raise WebError("WEB009", "the message must be sent as application/json")
    try:
        # The bytes, since text() would look up whatever charset the request names.
        body = await asyncio.wait_for(request.read(), BODY_SECONDS)
        data = json.loads(body, parse_constant=_refuse_constant)
    except asyncio.TimeoutError:
        raise WebError("WEB009", f"the request was not complete within {BODY_SECONDS:g} s") from None
    except (ValueError, RecursionError):
        data = None
    if not isinstance(data, dict):
        raise WebError("WEB009", "the message is not a JSON object")
    return data


_SHUTDOWN_SECONDS = 2.0
_REQUEST_SECONDS = 10.0
"""Time limit for a request's header, and for a connection's next request."""
MAX_CONNECTIONS = 128  # connections at once: far fewer than a process may have files open


class _Door(asyncio.Protocol):
    """Accepts connections, and closes those that have sent no request after some seconds.

    Otherwise, connections without a request would use up this process's files, and the page would be
    inaccessible. ``idle`` has the connections without a request so far, oldest first.
    """

    def __init__(
        self, runner: web.AppRunner, idle: dict[asyncio.BaseTransport, asyncio.TimerHandle], seconds: float
    ) -> None:
        self._runner, self._idle, self._seconds = runner, idle, seconds

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        """Accept the connection; if the limit is reached, it replaces an idle one."""
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
    """Serve connections to a listener, up to :data:`MAX_CONNECTIONS`.

    The runner's application gets the function for arrived requests as ``ARRIVED``; ``seconds`` limits a
    request's header.
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
    """Serve the page until SIGINT or SIGTERM; the watch is closed at the end.

    A ``port`` of 0 selects a free one; ``ready`` gets the address and port when the page can be opened.
    Raises WebError WEB001 if it cannot listen on this address.
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
