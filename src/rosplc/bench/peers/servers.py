"""What B of a client-server contender shares: orders on standard input beside an event loop."""

from __future__ import annotations

import asyncio
import os
import sys
from collections.abc import Callable

from rosplc.bench.peers.exchange import Order, say, ticks_ahead

__all__ = ["OrderTaker"]


class OrderTaker:
    """Tells a server's program when to work: at once, or in its own cycle.

    Args:
        work: Answers what has been written; called with nothing.

    Attributes:
        cyclic: Whether the program works in its cycle; else the server calls it itself.
    """

    def __init__(self, work: Callable[[], object]) -> None:
        self.cyclic = False
        self._work = work
        self._order = Order("answer", "block", 0, ())
        self._task: asyncio.Task[None] | None = None
        self.ended = asyncio.Event()

    def listen(self) -> None:
        """Take orders from now on, in the running loop."""
        asyncio.get_running_loop().add_reader(sys.stdin.fileno(), self._read)

    def _read(self) -> None:
        data = os.read(sys.stdin.fileno(), 4096)
        if not data:
            self.ended.set()
            return
        self._order = Order.parse(data.decode())
        self.cyclic = self._order.wait == "cycle"
        if self._task is not None:
            self._task.cancel()
            self._task = None
        if self.cyclic:
            self._task = asyncio.get_running_loop().create_task(self._cycle())
        say("answering")

    async def _cycle(self) -> None:
        period_ns = self._order.period_ns
        while True:
            await asyncio.sleep(ticks_ahead(period_ns, period_ns // 2))
            done = self._work()
            if asyncio.iscoroutine(done):
                await done
