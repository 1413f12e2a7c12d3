"""The WebSocket of one page: its wants come in, frames go out as fast as it takes them."""

from __future__ import annotations

import asyncio
import contextlib
import json
from typing import TYPE_CHECKING, Any

from aiohttp import WSMsgType, web

from rosplc._version import __version__
from rosplc.errors import RosplcError, WebError
from rosplc.web.access import require_token
from rosplc.web.feed import Wants

if TYPE_CHECKING:
    from rosplc.web.access import Settings
    from rosplc.web.feed import Feed, Wants


class Frames:
    """Makes the frames for one page.

    A frame has only what is new: ``channels`` (whole ones that are new to the page, else the members that
    differ), ``gone``, ``bridges``, ``notes``, ``events``, ``messages`` and ``samples``.
    """

    def __init__(self, feed: Feed) -> None:
        self._feed = feed
        self._document: dict[str, Any] | None = None
        self._channels: dict[str, dict[str, Any]] = {}
        self._event = 0
        self._messages: dict[str, int] = {}
        self._sample = 0
        self._failure = ""

    def next(self, wants: Wants) -> dict[str, Any] | None:
        """Return the next frame; None if nothing is new."""
        frame: dict[str, Any] = {}
        self._add_picture(frame)
        events = [(number, event) for number, event in self._feed.events if number > self._event]
        if events:
            frame["events"] = [{"number": number, **event} for number, event in events]
            self._event = events[-1][0]
        self._add_messages(frame, wants)
        self._add_samples(frame, wants)
        if self._feed.failure != self._failure:
            frame["failure"] = self._failure = self._feed.failure
        return frame or None

    def _add_picture(self, frame: dict[str, Any]) -> None:
        document = self._feed.document
        if document is None or document is self._document:
            return
        before = self._document or {}
        frame["time_ms"] = document["time_ns"] / 1e6
        changed = {}
        for channel, members in self._feed.channels.items():
            known = self._channels.get(channel, {})
            differs = {name: value for name, value in members.items() if known.get(name, ...) != value}
            if differs:
                changed[channel] = differs
        if changed:
            frame["channels"] = changed
        gone = [channel for channel in self._channels if channel not in self._feed.channels]
        if gone:
            frame["gone"] = gone
        for name in ("bridges", "notes"):
            if before.get(name) != document[name]:
                frame[name] = document[name]
        self._document, self._channels = document, self._feed.channels

    def _add_messages(self, frame: dict[str, Any], wants: Wants) -> None:
        found = {}
        for channel in wants.messages:
            number, message = self._feed.messages.get(channel, (0, {}))
            if number > self._messages.get(channel, 0):
                self._messages[channel] = number
                found[channel] = message
        for channel in self._messages.keys() - wants.messages:
            del self._messages[channel]
        if found:
            frame["messages"] = found

    def _add_samples(self, frame: dict[str, Any], wants: Wants) -> None:
        found: dict[str, dict[str, list[Any]]] = {}
        newest = self._sample
        for channel, paths in wants.plots.items():
            series = [each for each in self._feed.samples.get(channel, ()) if each[0] > self._sample]
            if not series:
                continue
            newest = max(newest, series[-1][0])
            found[channel] = {
                "t": [time_ms for _, time_ms, _ in series],
                **{f"v:{path}": [values.get(path) for _, _, values in series] for path in sorted(paths)},
            }
        if found:
            self._sample = newest
            frame["samples"] = found


_FRAME_SECONDS = 0.1
# A page changes its mind when somebody clicks.
_WANTS_SECONDS = 0.02
_HEARTBEAT_SECONDS = 15.0
_GREETING_SECONDS = 10.0
# A page that takes nothing for so long is gone, or might as well be.
_STALLED_SECONDS = 30.0
_LARGEST_BYTES = 64 * 1024


class Viewers:
    """The connected pages; ``machine`` is what they call this machine."""

    def __init__(self, settings: Settings, machine: str) -> None:
        self.feed: Feed
        self._settings = settings
        self._machine = machine
        self._wants: dict[web.WebSocketResponse, Wants] = {}
        self._connected = 0

    def wanted(self) -> list[Wants]:
        """Return what each page wants that has sent it."""
        return list(self._wants.values())

    async def close(self, _application: web.Application) -> None:
        """Close the connections of all pages, since the server ends."""
        for socket in list(self._wants):
            with contextlib.suppress(asyncio.TimeoutError, ConnectionError):
                await asyncio.wait_for(socket.close(code=1001, message=b"the server ends"), 1.0)

    async def handle(self, request: web.Request) -> web.StreamResponse:
        """Serve one page until it leaves; raises WebError WEB004 if no page of this server asks."""
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
            "time_ms": self.feed.clock.time_ns() / 1e6,
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
    """Return the page's next message; None if it has left. Raises WebError WEB009 if it is no JSON object."""
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
