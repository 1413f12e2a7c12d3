"""What pages are shown: one thread looks at the channels, and pages take what is new to them.

Nothing queues. The newest picture and the newest message of each channel stand here, events and
plotted samples in lists that forget their oldest. A slow page misses something and costs nothing.
"""

from __future__ import annotations

import asyncio
import contextlib
import itertools
from collections import deque
from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from typing import TYPE_CHECKING, Any, TypeVar

from rosplc.errors import RosplcError
from rosplc.web.looker import Look, Looker

if TYPE_CHECKING:
    from rosplc.monitor.picture import Event
    from rosplc.monitor.watch import Watch
    from rosplc.web.wants import Wants

__all__ = ["Feed"]

_T = TypeVar("_T")
_TURN_SECONDS = 0.05
_IDLE_SECONDS = 1.0
_EVENTS = 1000
_SAMPLES = 600


class Feed:
    """The looks of one server, for as long as :meth:`run` runs; for one event loop.

    Args:
        make_watch: Makes the watch; called in the thread that looks, which alone uses it.
        wanted: Returns what each connected page wants.

    Attributes:
        document: The last picture as ``rosplc status --json`` prints it; None before the first.
        channels: The same by id.
        events: What happened, each with a number that grows by one.
        messages: The newest message of each wanted channel, with a number that grows.
        samples: Per plotted channel its newest samples: number, ms since 1970, value by path.
        failure: Why the last look failed; empty if it did not.
    """

    def __init__(self, make_watch: Callable[[], Watch], wanted: Callable[[], Iterable[Wants]]) -> None:
        self.document: dict[str, Any] | None = None
        self.channels: dict[str, dict[str, Any]] = {}
        self.events: deque[tuple[int, dict[str, Any]]] = deque(maxlen=_EVENTS)
        self.messages: dict[str, tuple[int, dict[str, Any]]] = {}
        self.samples: dict[str, deque[tuple[int, float, dict[str, float | None]]]] = {}
        self.failure = ""
        self._make_watch = make_watch
        self._wanted = wanted
        self._looker: Looker | None = None
        self._numbers = itertools.count(1)
        self._thread = ThreadPoolExecutor(1, thread_name_prefix="rosplc-web-look")
        self._news = asyncio.Event()
        self._hurry = asyncio.Event()

    async def run(self) -> None:
        """Look until cancelled."""
        try:
            while True:
                wanted = list(self._wanted())
                try:
                    self._apply(await self.call(partial(_look, wanted)), wanted)
                except RosplcError as error:
                    self.failure = str(error)
                    self.tell()
                self._hurry.clear()
                with contextlib.suppress(asyncio.TimeoutError):
                    await asyncio.wait_for(self._hurry.wait(), _TURN_SECONDS if wanted else _IDLE_SECONDS)
        finally:
            self._thread.submit(self._close)
            self._thread.shutdown(wait=False)

    async def call(self, function: Callable[[Looker], _T]) -> _T:
        """Call a function in the thread that looks, and return what it returns."""

        def called() -> _T:
            if self._looker is None:
                self._looker = Looker(self._make_watch)
            return function(self._looker)

        return await asyncio.get_running_loop().run_in_executor(self._thread, called)

    def hurry(self) -> None:
        """Take the next turn now: a page came, or wants something else."""
        self._hurry.set()

    def note(self, event: Event) -> None:
        """Add an event of this server's own."""
        self.events.append((next(self._numbers), event.as_json()))
        self.tell()

    def tell(self) -> None:
        """Wake whoever waits for news."""
        self._news.set()
        self._news = asyncio.Event()

    async def news(self, seconds: float) -> None:
        """Wait until something has changed, or ``seconds`` have passed."""
        with contextlib.suppress(asyncio.TimeoutError):
            await asyncio.wait_for(self._news.wait(), seconds)

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

    def _close(self) -> None:
        if self._looker is not None:
            self._looker.watch.close()


def _look(wanted: list[Wants], looker: Looker) -> Look:
    return looker.look(wanted)
