"""What pages want and are shown: one thread looks at the channels, and pages take what is new to them.

Nothing queues. The newest picture and the newest message of each channel are kept here, events and plotted
samples in lists that forget their oldest. A slow page misses something and costs nothing.
"""

from __future__ import annotations

import asyncio
import itertools
import logging
import re
from collections import deque
from collections.abc import Callable, Iterable, Set
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from functools import lru_cache
from typing import Any

from rosplc.errors import RosplcError, WebError
from rosplc.monitor.message import Message
from rosplc.monitor.picture import Event, Picture
from rosplc.monitor.watch import Watch
from rosplc.web.write import shown

MAX_PATH = 300  # characters of the longest path that is accepted

_STEP = re.compile(r"(?:^|\.)([A-Za-z_][A-Za-z0-9_]*)|\[([0-9]{1,8})\]")


@lru_cache(maxsize=1024)
def parse_path(text: str) -> tuple[str | int, ...]:
    """Return the steps of a path, names of fields and indices of elements; raises ValueError for others."""
    steps: list[str | int] = []
    at = 0
    while at < len(text) <= MAX_PATH:
        found = _STEP.match(text, at)
        if found is None or found.end() == at:
            break
        steps.append(found[1] if found[2] is None else int(found[2]))
        at = found.end()
    if not steps or at != len(text):
        raise ValueError(f"{text[:80]!r} is no path of a field")
    return tuple(steps)


def number_at(message: Any, path: str) -> float | int | None:
    """Return the number at a path of a message; None if there is none.

    A bool counts as 0 or 1. NaN and infinities are None: they have no place in a plot.
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
    """What one page wants: ids of channels whose message it shows, and per id the paths that it plots."""

    messages: frozenset[str] = frozenset()
    plots: dict[str, frozenset[str]] = field(default_factory=dict)

    @classmethod
    def of(cls, data: Any) -> Wants:
        """Return the wants in a page's JSON.

        Raises WebError WEB009 if it has another form, or wants more than one page may.
        """
        found = data if isinstance(data, dict) else {"messages": None}
        messages, plots = found.get("messages", []), found.get("plots", {})
        if not isinstance(messages, list) or not isinstance(plots, dict):
            raise _malformed("what a page wants is an object: `messages` is a list, `plots` an object")
        for name in [*messages, *plots]:
            if not isinstance(name, str) or len(name) > _MAX_ID:
                raise _malformed("a channel's id is a text")
        fields = [path for paths in plots.values() for path in (paths if isinstance(paths, list) else [None])]
        for path in fields:
            if not isinstance(path, str):
                raise _malformed("the fields to plot are a list of paths")
            try:
                parse_path(path)
            except ValueError as error:
                raise _malformed(str(error)) from None
        if len(messages) > MAX_MESSAGES or len(fields) > MAX_PLOTS:
            raise _malformed(f"a page may open {MAX_MESSAGES} messages and plot {MAX_PLOTS} fields")
        return cls(frozenset(messages), {name: frozenset(paths) for name, paths in plots.items() if paths})


def _malformed(what: str) -> WebError:
    return WebError("WEB009", what)


_PICTURE_NS = 500_000_000
_UNWATCHED_NS = 1_000_000_000
_SAMPLE_NS = 50_000_000
# A look, or decoding a large message, is followed by a pause of so many times as long.
_PAUSE = 4
_STAMP_MS = 500


@dataclass
class Look:
    """What one turn of looking has found.

    ``picture``: all channels, if it was time for them; by id ``messages``, what is shown of each wanted one
    that is new, and ``samples``, the time in ms since 1970 and the plotted fields' values by path.
    """

    picture: Picture | None = None
    messages: dict[str, dict[str, Any]] = field(default_factory=dict)
    samples: dict[str, tuple[float, dict[str, float | None]]] = field(default_factory=dict)


class Looker:
    """Takes looks; for one thread."""

    def __init__(self, watch: Watch) -> None:
        self._watch, self._clock = watch, watch.clock
        self._due: dict[str, int] = {}
        self._seen: dict[str, tuple[object, ...]] = {}

    def look(self, wanted: Iterable[Wants]) -> Look:
        """Look at what pages want, if it is time to; raises RosplcError if channels cannot be listed."""
        wanted = list(wanted)
        messages: Set[str] = frozenset().union(*(each.messages for each in wanted))
        plots: dict[str, set[str]] = {}
        for each in wanted:
            for channel, paths in each.plots.items():
                plots.setdefault(channel, set()).update(paths)
        found = Look()
        if self._is_due(""):
            started = self._clock.monotonic_ns()
            found.picture = self._watch.look()
            self._next("", started, _PICTURE_NS if wanted else _UNWATCHED_NS)
        for channel in messages | plots.keys():
            if self._is_due(channel):
                started = self._clock.monotonic_ns()
                self._message(found, channel, channel in messages, frozenset(plots.get(channel, ())))
                self._next(channel, started, _SAMPLE_NS)
        for channel in self._due.keys() - messages - plots.keys() - {""}:
            del self._due[channel]
            self._seen.pop(channel, None)
        return found

    def _is_due(self, name: str) -> bool:
        return self._clock.monotonic_ns() >= self._due.get(name, 0)

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
            found.messages[channel] = _page_form(message)

    def _news(self, found: Look, channel: str, mark: tuple[object, ...], news: dict[str, Any]) -> None:
        if self._seen.get(channel) != mark:
            self._seen[channel] = mark
            found.messages[channel] = news


def _time_of(message: Message, now_ms: float) -> float:
    """Return when a message came: its stamp, if that is of about now, which is more exact than a look."""
    stamp_ms = message.stamp_ns / 1e6
    return stamp_ms if message.clock and 0 <= now_ms - stamp_ms < _STAMP_MS else now_ms


def _page_form(message: Message) -> dict[str, Any]:
    return {
        "type": message.type_name,
        "sequence": message.sequence,
        # Nanoseconds since 1970 are beyond what a page can count.
        "stamp_ms": message.stamp_ns / 1e6 if message.stamp_ns else None,
        "clock": message.clock,
        "marks": list(message.marks),
        "values": shown(message.values),
    }


_log = logging.getLogger("rosplc.web")
_TURN_SECONDS = 0.05
_IDLE_SECONDS = 1.0
_EVENTS = 1000
_SAMPLES = 600


class Feed:
    """The looks of one server, for as long as :meth:`run` runs; for one event loop.

    ``wanted`` returns what each connected page wants; from now on only the thread that looks uses the watch.
    ``document`` is the last picture as ``rosplc status --json`` prints it, None before the first,
    ``channels`` the same by id. ``events`` and the newest ``messages`` of wanted channels have numbers that
    grow; ``samples`` are per plotted channel number, ms since 1970 and values by path. ``failure`` is why the
    last look failed, or empty.
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
                    _log.exception("a look failed")
                    self._fail(f"A look failed: {type(error).__name__}: {error}")
                self._hurry.clear()
                # No wait_for: before Python 3.12 it may swallow the cancellation that ends this.
                alarm = loop.call_later(_TURN_SECONDS if wanted else _IDLE_SECONDS, self._hurry.set)
                await self._hurry.wait()
                alarm.cancel()
        finally:
            # Waits for the look that is being taken: whoever started this closes the watch next.
            self._thread.shutdown(cancel_futures=True)

    def hurry(self) -> None:
        """Take the next turn now: a page came, or wants something else."""
        self._hurry.set()

    def note(self, event: Event) -> None:
        """Add an event of this server's own."""
        self.events.append((next(self._numbers), event.as_json()))
        self.tell()

    def tell(self) -> None:
        """Wake all that wait for news."""
        self._news.set()
        self._news = asyncio.Event()

    async def news(self) -> None:
        """Wait until something has changed; a picture comes at least every second or so."""
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
