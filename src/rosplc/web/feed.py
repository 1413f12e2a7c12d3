"""What pages are shown: one thread looks at the channels, and pages take what is new to them.

Nothing queues. The newest picture and the newest message of each channel stand here, events and
plotted samples in lists that forget their oldest. A slow page misses something and costs nothing.
"""

from __future__ import annotations

import asyncio
import itertools
import logging
from collections import deque
from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor
from typing import TYPE_CHECKING, Any

from rosplc.errors import RosplcError
from rosplc.web.looker import Look, Looker

if TYPE_CHECKING:
    from rosplc.monitor.picture import Event
    from rosplc.monitor.watch import Watch
    from rosplc.web.wants import Wants

__all__ = ["Feed"]

_log = logging.getLogger("rosplc.web")
_TURN_SECONDS = 0.05
_IDLE_SECONDS = 1.0
_EVENTS = 1000
_SAMPLES = 600


class Feed:
    """The looks of one server, for as long as :meth:`run` runs; for one event loop.

    Args:
        watch: What to look with; from now on the thread that looks alone uses it.
        wanted: Returns what each connected page wants.

    Attributes:
        document: The last picture as ``rosplc status --json`` prints it; None before the first.
        channels: The same by id.
        events: What happened, each with a number that grows by one.
        messages: The newest message of each wanted channel, with a number that grows.
        samples: Per plotted channel its newest samples: number, ms since 1970, value by path.
        failure: Why the last look failed; empty if it did not.
    """

    def __init__(self, watch: Watch, wanted: Callable[[], Iterable[Wants]]) -> None:
        self.document: dict[str, Any] | None = None
        self.channels: dict[str, dict[str, Any]] = {}
        self.events: deque[tuple[int, dict[str, Any]]] = deque(maxlen=_EVENTS)
        self.messages: dict[str, tuple[int, dict[str, Any]]] = {}
        self.samples: dict[str, deque[tuple[int, float, dict[str, float | None]]]] = {}
        self.failure = ""
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
                    self._apply(await self._in_thread(wanted), wanted)
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
        """Wake whoever waits for news."""
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

    async def _in_thread(self, wanted: list[Wants]) -> Look:
        return await asyncio.get_running_loop().run_in_executor(self._thread, self._looker.look, wanted)
