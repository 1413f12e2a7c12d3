"""Live data for pages: one thread looks at the channels, and each page gets the data that is new to it.

There are no queues. The newest picture and the newest message of each channel are kept here, and the latest
events and plotted samples in bounded lists. A slow page misses data but costs nothing. A page sends its
requests over its WebSocket and receives frames as fast as it accepts them.
"""

from __future__ import annotations

import asyncio
import contextlib
import itertools
import json
import logging
import re
from collections import deque
from collections.abc import Callable, Iterable, Set
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from functools import lru_cache
from typing import Any

from aiohttp import WSMsgType, web

from rosplc._version import __version__
from rosplc.errors import RosplcError, WebError
from rosplc.monitor.message import Message
from rosplc.monitor.picture import Event, Picture
from rosplc.monitor.watch import Watch
from rosplc.web.access import Settings, require_token
from rosplc.web.write import shown

MAX_PATH = 300  # characters of the longest path that is accepted

_STEP = re.compile(r"(?:^|\.)([A-Za-z_][A-Za-z0-9_]*)|\[([0-9]{1,8})\]")


@lru_cache(maxsize=1024)
def parse_path(text: str) -> tuple[str | int, ...]:
    """Return the steps of a path, as field names and element indices; raises ValueError if it is invalid."""
    steps: list[str | int] = []
    at = 0
    while at < len(text) <= MAX_PATH:
        found = _STEP.match(text, at)
        if found is None or found.end() == at:
            break
        steps.append(found[1] if found[2] is None else int(found[2]))
        at = found.end()
    if not steps or at != len(text):
        raise ValueError(f"{text[:80]!r} is not a field path")
    return tuple(steps)


def number_at(message: Any, path: str) -> float | int | None:
    """Return the number at a path in a message; None if there is none.

    A bool counts as 0 or 1. NaN and infinities become None, because they cannot be plotted.
    """
    value = message
    try:
        for step in parse_path(path):
            value = value[step]
    except (LookupError, TypeError):
        return None
    if not isinstance(value, int | float):
        return None
    value = int(value) if isinstance(value, bool) else value
    return value if value - value == 0 else None


MAX_MESSAGES = 4  # messages that one page may have open
MAX_PLOTS = 24  # fields that one page may plot
_MAX_ID = 300


@dataclass(frozen=True)
class Wants:
    """A page's requests: the ids of channels whose messages it shows, and per id the paths that it plots."""

    messages: frozenset[str] = frozenset()
    plots: dict[str, frozenset[str]] = field(default_factory=dict)

    @classmethod
    def of(cls, data: Any) -> Wants:
        """Return the requests in a page's JSON.

        Raises WebError WEB009 if it has another form, or exceeds the limits for one page.
        """
        found = data if isinstance(data, dict) else {"messages": None}
        messages, plots = found.get("messages", []), found.get("plots", {})
        if not isinstance(messages, list) or not isinstance(plots, dict):
            what = "a page's request must be an object with a list `messages` and an object `plots`"
            raise WebError("WEB009", what)
        for name in [*messages, *plots]:
            if not isinstance(name, str) or len(name) > _MAX_ID:
                raise WebError("WEB009", "a channel's id must be a string")
        fields = [path for paths in plots.values() for path in (paths if isinstance(paths, list) else [None])]
        for path in fields:
            if not isinstance(path, str):
                raise WebError("WEB009", "the fields to plot must be a list of paths")
            try:
                parse_path(path)
            except ValueError as error:
                raise WebError("WEB009", str(error)) from None
        if len(messages) > MAX_MESSAGES or len(fields) > MAX_PLOTS:
            raise WebError("WEB009", f"a page can have at most {MAX_MESSAGES} messages and {MAX_PLOTS} plots")
        return cls(frozenset(messages), {name: frozenset(paths) for name, paths in plots.items() if paths})


_PICTURE_NS = 500_000_000
_UNWATCHED_NS = 1_000_000_000
_SAMPLE_NS = 50_000_000
# A look, or decoding a large message, is followed by a pause of so many times as long.
_PAUSE = 4
_STAMP_MS = 500


@dataclass
class Look:
    """The result of one look.

    ``picture`` has all channels, if they were due; by channel id, ``messages`` has the new messages to show,
    and ``samples`` the time in ms since 1970 and the plotted fields' values by path.
    """

    picture: Picture | None = None
    messages: dict[str, dict[str, Any]] = field(default_factory=dict)
    samples: dict[str, tuple[float, dict[str, float | None]]] = field(default_factory=dict)


class Looker:
    """Looks at channels; for one thread."""

    def __init__(self, watch: Watch) -> None:
        self._watch, self._clock = watch, watch.clock
        self._due: dict[str, int] = {}
        self._seen: dict[str, tuple[object, ...]] = {}

    def look(self, wanted: Iterable[Wants]) -> Look:
        """Look at the requested data that is due; raises RosplcError if channels cannot be listed."""
        wanted = list(wanted)
        messages: Set[str] = frozenset().union(*(each.messages for each in wanted))
        plots: dict[str, set[str]] = {}
        for each in wanted:
            for channel, paths in each.plots.items():
                plots.setdefault(channel, set()).update(paths)
        found = Look()
        if self._clock.monotonic_ns() >= self._due.get("", 0):
            started = self._clock.monotonic_ns()
            found.picture = self._watch.look()
            self._next("", started, _PICTURE_NS if wanted else _UNWATCHED_NS)
        for channel in messages | plots.keys():
            if self._clock.monotonic_ns() >= self._due.get(channel, 0):
                started = self._clock.monotonic_ns()
                self._message(found, channel, channel in messages, frozenset(plots.get(channel, ())))
                self._next(channel, started, _SAMPLE_NS)
        for channel in self._due.keys() - messages - plots.keys() - {""}:
            del self._due[channel]
            self._seen.pop(channel, None)
        return found

    def _next(self, name: str, started: int, period_ns: int) -> None:
        now = self._clock.monotonic_ns()
        # A little early rather than a turn late: the turns themselves come at this distance.
        self._due[name] = max(started + period_ns * 4 // 5, now + (now - started) * _PAUSE)

    def _message(self, found: Look, channel: str, wanted: bool, paths: Set[str]) -> None:
        try:
            message = self._watch.message(channel)
        except RosplcError as error:
            self._news(found, channel, ("error", error.code), {"error": error.to_dict()})
            return
        if message is None:
            self._news(found, channel, ("none",), {"none": True})
            return
        mark = ("message", message.sequence, message.stamp_ns, message.type_name)
        # A classic topic's messages have no numbers: each look may have found a new one.
        if message.sequence and self._seen.get(channel) == (*mark, wanted, paths):
            return
        self._seen[channel] = (*mark, wanted, paths)
        now_ms = self._clock.time_ns() / 1e6
        if paths:
            values = {path: number_at(message.values, path) for path in paths}
            found.samples[channel] = (_time_of(message, now_ms), values)
        if wanted:
            found.messages[channel] = {
                "type": message.type_name,
                "sequence": message.sequence,
                # Nanoseconds since 1970 are beyond what a page can count.
                "stamp_ms": message.stamp_ns / 1e6 if message.stamp_ns else None,
                "clock": message.clock,
                "marks": list(message.marks),
                "values": shown(message.values),
            }

    def _news(self, found: Look, channel: str, mark: tuple[object, ...], news: dict[str, Any]) -> None:
        if self._seen.get(channel) != mark:
            self._seen[channel] = mark
            found.messages[channel] = news


def _time_of(message: Message, now_ms: float) -> float:
    """Return when a message arrived: its stamp, if close to now, since it is more precise than a look."""
    stamp_ms = message.stamp_ns / 1e6
    return stamp_ms if message.clock and 0 <= now_ms - stamp_ms < _STAMP_MS else now_ms


_log = logging.getLogger("rosplc.web")
_TURN_SECONDS = 0.05
_IDLE_SECONDS = 1.0
_EVENTS = 1000
_SAMPLES = 600


class Feed:
    """The looks of one server while :meth:`run` is running; for one event loop.

    ``wanted`` returns the requests of each connected page; from now on, only the looking thread uses the
    watch. ``document`` is the last picture as printed by ``rosplc status --json``, None before the first;
    ``channels`` is the same by id. ``events`` and the newest ``messages`` of requested channels have
    increasing numbers; ``samples`` has, per plotted channel, a number, ms since 1970 and values by path.
    ``failure`` is the reason why the last look failed, or empty.
    """

    def __init__(self, watch: Watch, wanted: Callable[[], Iterable[Wants]]) -> None:
        self.document: dict[str, Any] | None = None
        self.channels: dict[str, dict[str, Any]] = {}
        self.events: deque[tuple[int, dict[str, Any]]] = deque(maxlen=_EVENTS)
        self.messages: dict[str, tuple[int, dict[str, Any]]] = {}
        self.samples: dict[str, deque[tuple[int, float, dict[str, float | None]]]] = {}
        self.failure = ""
        self.clock = watch.clock
        self._wanted = wanted
        self._looker = Looker(watch)
        self._numbers = itertools.count(1)
        self._thread = ThreadPoolExecutor(1, thread_name_prefix="rosplc-web-look")
        self._news = asyncio.Event()
        self._hurry = asyncio.Event()

    async def run(self) -> None:
        """Look until cancelled."""
        loop = asyncio.get_running_loop()
        try:
            while True:
                wanted = list(self._wanted())
                try:
                    look = await loop.run_in_executor(self._thread, self._looker.look, wanted)
                    self._apply(look, wanted)
                except RosplcError as error:
                    self._fail(str(error))
                except Exception as error:
                    # A look at what somebody else has made must not end all looks.
                    _log.exception("reading the channels failed")
                    self._fail(f"Reading the channels failed: {type(error).__name__}: {error}")
                self._hurry.clear()
                # No wait_for: before Python 3.12 it may swallow the cancellation that ends this.
                alarm = loop.call_later(_TURN_SECONDS if wanted else _IDLE_SECONDS, self._hurry.set)
                await self._hurry.wait()
                alarm.cancel()
        finally:
            # Waits for the look that is being taken: the one that started this closes the watch next.
            self._thread.shutdown(cancel_futures=True)

    def hurry(self) -> None:
        """Look again now: a page has connected, or its requests have changed."""
        self._hurry.set()

    def note(self, event: Event) -> None:
        """Add an event of this server."""
        self.events.append((next(self._numbers), event.as_json()))
        self.tell()

    def tell(self) -> None:
        """Wake all tasks that wait for changes."""
        self._news.set()
        self._news = asyncio.Event()

    async def news(self) -> None:
        """Wait for a change; there is a new picture at least about every second."""
        await self._news.wait()

    def _fail(self, what: str) -> None:
        if self.failure != what:
            self.failure = what
            self.tell()

    def _apply(self, look: Look, wanted: list[Wants]) -> None:
        self.failure = ""
        if look.picture is not None:
            self.document = look.picture.as_json()
            self.channels = {channel["id"]: channel for channel in self.document["channels"]}
            for event in self.document["events"]:
                self.events.append((next(self._numbers), event))
        for channel, message in look.messages.items():
            self.messages[channel] = (next(self._numbers), message)
        for channel, (time_ms, values) in look.samples.items():
            series = self.samples.setdefault(channel, deque(maxlen=_SAMPLES))
            # A page expects times in order, and a stamp may lie before a look.
            series.append((next(self._numbers), max(time_ms, series[-1][1] if series else 0.0), values))
        messages = frozenset().union(*(each.messages for each in wanted))
        plotted = frozenset().union(*(each.plots.keys() for each in wanted))
        for channel in self.messages.keys() - messages:
            del self.messages[channel]
        for channel in self.samples.keys() - plotted:
            del self.samples[channel]
        if look.picture is not None or look.messages or look.samples:
            self.tell()


class Frames:
    """Makes the frames for one page.

    A frame contains only changes: ``channels`` (complete if new to the page, otherwise the members that
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
    """The connected pages; ``machine`` is the displayed name of this machine."""

    def __init__(self, settings: Settings, machine: str) -> None:
        self.feed: Feed
        self._settings = settings
        self._machine = machine
        self._wants: dict[web.WebSocketResponse, Wants] = {}
        self._connected = 0

    def wanted(self) -> list[Wants]:
        """Return the requests of each page that has sent some."""
        return list(self._wants.values())

    async def close(self, _application: web.Application) -> None:
        """Close the connections of all pages at the end of the server."""
        for socket in list(self._wants):
            with contextlib.suppress(asyncio.TimeoutError, ConnectionError):
                await asyncio.wait_for(socket.close(code=1001, message=b"the server ends"), 1.0)

    async def handle(self, request: web.Request) -> web.StreamResponse:
        """Serve one page until it disconnects; raises WebError WEB004 if it is not a page of this server."""
        if "Origin" not in request.headers:
            raise WebError("WEB004", "only a page of this server may open a WebSocket")
        socket = web.WebSocketResponse(
            heartbeat=_HEARTBEAT_SECONDS, max_msg_size=_LARGEST_BYTES, compress=False
        )
        self._connected += 1
        try:
            await socket.prepare(request)
            if self._connected > self._settings.viewers:
                raise WebError("WEB007", f"{self._settings.viewers} pages are already connected")
            await self._serve(socket, request)
        except RosplcError as error:
            with contextlib.suppress(ConnectionError, asyncio.TimeoutError):
                await _send(socket, {"error": error.to_dict()})
                await socket.close(code=1008, message=error.code.encode())
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


async def _receive(socket: web.WebSocketResponse, seconds: float | None) -> dict[str, Any] | None:
    """Return the page's next message; None if it disconnected. Raises WebError WEB009 if it is invalid."""
    while True:
        message = await socket.receive(seconds)
        if message.type is WSMsgType.TEXT:
            break
        if message.type in (WSMsgType.CLOSE, WSMsgType.CLOSING, WSMsgType.CLOSED, WSMsgType.ERROR):
            return None
        if message.type is WSMsgType.BINARY:
            raise WebError("WEB009", "binary messages are not accepted")
    try:
        data = json.loads(message.data)
    except (ValueError, RecursionError):
        data = None
    if not isinstance(data, dict):
        raise WebError("WEB009", "the message is not a JSON object")
    return data


async def _send(socket: web.WebSocketResponse, frame: dict[str, Any]) -> None:
    # send_str waits while the page does not take what was sent before: that bounds what is kept for it.
    await asyncio.wait_for(socket.send_str(json.dumps(frame, separators=(",", ":"))), _STALLED_SECONDS)
