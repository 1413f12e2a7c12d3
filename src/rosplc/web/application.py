"""What the server answers: the page, its data, and the one thing it writes."""

from __future__ import annotations

import asyncio
import contextlib
import json
import logging
import time
from collections.abc import AsyncIterator, Callable
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from typing import TYPE_CHECKING, Any

from aiohttp import web
from aiohttp.typedefs import Handler

from rosplc.described import layout_of
from rosplc.errors import RosplcError, WebError
from rosplc.levels import Level
from rosplc.monitor.picture import Event
from rosplc.shm import Namespace
from rosplc.shm import attach as attach_object
from rosplc.web.access import access, add_headers, bearer, require_token
from rosplc.web.feed import Feed
from rosplc.web.form import form_of
from rosplc.web.live import Viewers
from rosplc.web.pages import PageFiles
from rosplc.web.write import write_message

if TYPE_CHECKING:
    from rosplc.monitor.watch import Watch
    from rosplc.web.settings import Settings

__all__ = ["ARRIVED", "make_application"]

_log = logging.getLogger("rosplc.web")
_LARGEST_BYTES = 4 * 1024 * 1024
BODY_SECONDS = 10.0
"""How long a request's body may take."""


ARRIVED: web.AppKey[list[Callable[[asyncio.BaseTransport | None], None]]] = web.AppKey("arrived", list)
"""Called with a connection's transport when a request's head has come."""


@web.middleware
async def arrival(request: web.Request, handler: Handler) -> web.StreamResponse:
    """Tell those who wait for it that a connection has sent a request."""
    for tell in request.app[ARRIVED]:
        tell(request.transport)
    return await handler(request)


def make_application(settings: Settings, watch: Watch, machine: str) -> web.Application:
    """Return the application; it looks from its start to its clean-up.

    Args:
        settings: What it was told.
        watch: What it looks with.
        machine: What the page calls this machine.
    """
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

    async def goodbye(_application: web.Application) -> None:
        await viewers.close()

    files = PageFiles()
    application = web.Application(middlewares=[arrival, access(settings)], client_max_size=_LARGEST_BYTES)
    application[ARRIVED] = []
    application.cleanup_ctx.append(looking)
    application.on_shutdown.append(goodbye)
    application.on_response_prepare.append(add_headers)
    application.add_routes(
        [
            web.get("/", files.index),
            web.get("/static/{name}", files.file),
            web.get("/api/live", viewers.handle),
            web.get("/api/status", api.status),
            web.get("/api/form", api.form),
            web.post("/api/token", api.token),
            web.post("/api/write", api.write),
        ]
    )
    return application


class _Api:
    """Questions and answers beside the WebSocket."""

    def __init__(self, settings: Settings) -> None:
        self.feed: Feed
        self._settings = settings
        self._writing = ThreadPoolExecutor(1, thread_name_prefix="rosplc-web-write")
        self._last_wrong = 0.0

    async def status(self, _request: web.Request) -> web.Response:
        """Answer with what ``rosplc status --json`` prints, as of the last look."""
        if self.feed.document is None and not self.feed.failure:
            await self.feed.news()
        return web.json_response(self.feed.document or {})

    async def form(self, request: web.Request) -> web.Response:
        """Answer with a channel's type, as :func:`rosplc.web.form.form_of` gives it."""
        return web.json_response(await self._in_thread(self._form, request.query.get("channel", "")))

    async def token(self, request: web.Request) -> web.Response:
        """Say whether the request's token is the right one."""
        await self._require_token(request)
        return web.json_response({"token": "right"})

    async def write(self, request: web.Request) -> web.Response:
        """Write a test message: ``{"channel": id, "layout": id, "message": {...}, "not_finite": bool}``."""
        if not self._settings.allow_write:
            raise WebError("WEB006", "this server was started for looking only")
        await self._require_token(request)
        wish = await _json(request)
        channel, layout, message = wish.get("channel"), wish.get("layout"), wish.get("message")
        if not isinstance(channel, str) or not isinstance(layout, str) or not isinstance(message, dict):
            raise WebError("WEB009", "`channel` and `layout` are texts, `message` an object")
        view = self._channel(channel)
        namespace = Namespace(view["prefix"], self._settings.directory)
        who = f"the page at {request.remote}"
        try:
            write = partial(write_message, not_finite=wish.get("not_finite") is True)
            sequence = await self._in_thread(write, namespace, view["topic"], layout, message)
        except RosplcError as error:
            self._note("write-refused", Level.WARN, view, f"{who} may not write: {error.what} [{error.code}]")
            raise
        self._note("written", Level.OK, view, f"{who} wrote a test message, number {sequence}")
        return web.json_response({"sequence": sequence})

    def _form(self, channel: str) -> dict[str, Any]:
        view = self._channel(channel)
        namespace = Namespace(view["prefix"], self._settings.directory)
        with attach_object(namespace, view["topic"]) as attached:
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
            raise WebError("WEB008", "there is no such channel now", where=channel[:200])
        if view["classic"]:
            raise WebError("WEB008", "a classic topic's memory describes no type", where=view["topic"])
        return view

    async def _require_token(self, request: web.Request) -> None:
        try:
            require_token(self._settings, bearer(request))
        except WebError:
            # Nobody guesses 144 bits; a short token of somebody's own deserves the brake.
            await asyncio.sleep(0.5)
            _log.warning("a request from %s had a wrong token", request.remote)
            raise

    async def _in_thread(self, function: Callable[..., Any], *arguments: Any) -> Any:
        return await asyncio.get_running_loop().run_in_executor(self._writing, function, *arguments)

    def _note(self, kind: str, level: Level, view: dict[str, Any], words: str) -> None:
        _log.log(logging.INFO if level is Level.OK else logging.WARNING, "%s: %s", view["topic"], words)
        event = Event(time.time_ns(), kind, level, view["id"], view["prefix"], view["topic"], words)
        self.feed.note(event)


def _refuse_constant(name: str) -> float:
    raise ValueError(f"{name} is no JSON")


async def _json(request: web.Request) -> dict[str, Any]:
    if request.content_type != "application/json":
        raise WebError("WEB009", "a message is sent as application/json")
    try:
        # The bytes, since text() would look up whatever charset the request names.
        body = await asyncio.wait_for(request.read(), BODY_SECONDS)
        data = json.loads(body, parse_constant=_refuse_constant)
    except asyncio.TimeoutError:
        raise WebError("WEB009", f"the request did not end within {BODY_SECONDS:g} s") from None
    except (ValueError, RecursionError):
        data = None
    if not isinstance(data, dict):
        raise WebError("WEB009", "a message that is no JSON object")
    return data
