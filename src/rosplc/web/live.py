"""The WebSocket of one page: its wants come in, frames go out as fast as it takes them."""

from __future__ import annotations

import asyncio
import contextlib
import json
import time
from typing import TYPE_CHECKING, Any

from aiohttp import WSMsgType, web

from rosplc._version import __version__
from rosplc.errors import RosplcError, WebError
from rosplc.web.access import require_token
from rosplc.web.frames import Frames
from rosplc.web.wants import Wants

if TYPE_CHECKING:
    from rosplc.web.feed import Feed
    from rosplc.web.settings import Settings

__all__ = ["Viewers"]

_FRAME_SECONDS = 0.1
# A page changes its mind when somebody clicks.
_WANTS_SECONDS = 0.02
_HEARTBEAT_SECONDS = 15.0
_GREETING_SECONDS = 10.0
# A page that takes nothing for so long is gone, or might as well be.
_STALLED_SECONDS = 30.0
_LARGEST_BYTES = 64 * 1024


class Viewers:
    """The connected pages.

    Args:
        settings: The server's settings.
        machine: What the page calls this machine.
    """

    def __init__(self, settings: Settings, machine: str) -> None:
        self.feed: Feed
        self._settings = settings
        self._machine = machine
        self._wants: dict[web.WebSocketResponse, Wants] = {}
        self._connected = 0

    def wanted(self) -> list[Wants]:
        """Return what each page wants that has said so."""
        return list(self._wants.values())

    async def close(self) -> None:
        """Say goodbye to all pages, since the server ends."""
        for socket in list(self._wants):
            with contextlib.suppress(asyncio.TimeoutError, ConnectionError):
                await asyncio.wait_for(socket.close(code=1001, message=b"the server ends"), 1.0)

    async def handle(self, request: web.Request) -> web.StreamResponse:
        """Serve one page until it leaves.

        Raises:
            WebError: WEB004, no page of this server asks.
        """
        if "Origin" not in request.headers:
            raise WebError("WEB004", "only a page of this server may open a WebSocket")
        socket = web.WebSocketResponse(
            heartbeat=_HEARTBEAT_SECONDS, max_msg_size=_LARGEST_BYTES, compress=False
        )
        self._connected += 1
        try:
            await socket.prepare(request)
            if self._connected > self._settings.viewers:
                raise WebError("WEB007", f"{self._settings.viewers} pages are connected")
            await self._serve(socket, request)
        except RosplcError as error:
            await self._refuse(socket, error)
        except (ConnectionError, asyncio.TimeoutError):
            pass  # it has left, or takes nothing any more
        finally:
            self._connected -= 1
            self._wants.pop(socket, None)
            with contextlib.suppress(ConnectionError):
                await socket.close()
        return socket

    async def _serve(self, socket: web.WebSocketResponse, request: web.Request) -> None:
        greeting = await _receive(socket, _GREETING_SECONDS)
        if greeting is None:
            return
        if self._settings.token_to_view:
            token = greeting.get("token", "")
            require_token(self._settings, token if isinstance(token, str) else "")
        self._wants[socket] = Wants.of(greeting.get("wants", {}))
        self.feed.hurry()
        hello = {
            "version": __version__,
            "machine": self._machine,
            "write": self._settings.allow_write,
            "time_ms": time.time_ns() / 1e6,
        }
        await _send(socket, {"hello": hello})
        sending = asyncio.create_task(self._send_frames(socket, request))
        try:
            while (message := await _receive(socket, None)) is not None:
                self._wants[socket] = Wants.of(message.get("wants", {}))
                self.feed.hurry()
                await asyncio.sleep(_WANTS_SECONDS)
        finally:
            self._wants.pop(socket, None)
            sending.cancel()
            with contextlib.suppress(asyncio.CancelledError, ConnectionError, asyncio.TimeoutError):
                await sending

    async def _send_frames(self, socket: web.WebSocketResponse, request: web.Request) -> None:
        frames = Frames(self.feed)
        try:
            # Not until it is cancelled: before Python 3.12 wait_for may swallow that.
            while (wants := self._wants.get(socket)) is not None:
                frame = frames.next(wants)
                if frame is not None:
                    await _send(socket, frame)
                    await asyncio.sleep(_FRAME_SECONDS)
                else:
                    await self.feed.news()
        except (ConnectionError, asyncio.TimeoutError):
            # To say goodbye would wait for the page once more.
            if request.transport is not None:
                request.transport.abort()

    async def _refuse(self, socket: web.WebSocketResponse, error: RosplcError) -> None:
        with contextlib.suppress(ConnectionError, asyncio.TimeoutError):
            await _send(socket, {"error": error.to_dict()})
            await socket.close(code=1008, message=error.code.encode())


async def _receive(socket: web.WebSocketResponse, seconds: float | None) -> dict[str, Any] | None:
    """Return the page's next message; None if it has left.

    Raises:
        WebError: WEB009, the message is no JSON object.
    """
    while True:
        message = await socket.receive(seconds)
        if message.type is WSMsgType.TEXT:
            break
        if message.type in (WSMsgType.CLOSE, WSMsgType.CLOSING, WSMsgType.CLOSED, WSMsgType.ERROR):
            return None
        if message.type is WSMsgType.BINARY:
            raise WebError("WEB009", "a message of bytes")
    try:
        data = json.loads(message.data)
    except (ValueError, RecursionError):
        data = None
    if not isinstance(data, dict):
        raise WebError("WEB009", "a message that is no JSON object")
    return data


async def _send(socket: web.WebSocketResponse, frame: dict[str, Any]) -> None:
    # send_str waits while the page does not take what was sent before: that bounds what is kept for it.
    await asyncio.wait_for(socket.send_str(json.dumps(frame, separators=(",", ":"))), _STALLED_SECONDS)
