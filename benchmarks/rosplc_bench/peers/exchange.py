"""The experiment's two sides in Python: ``c/exchange.h`` in another language, with the same requests."""

from __future__ import annotations

import asyncio
import itertools
import json
import os
import signal
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

Numbers: TypeAlias = NDArray[np.uint16]

COUNT = 100
"""Numbers of 16 bits that each message holds."""

_WATCHDOG = 300


@dataclass(frozen=True)
class Request:
    """A line of input: what to do and how to wait.

    Attributes:
        verb: "answer" or "run".
        wait: "spin", "yield", "block" or "cycle".
        period_ns: Of the cycle.
        numbers: The rest.
    """

    verb: str
    wait: str
    period_ns: int
    numbers: tuple[int, ...]

    @classmethod
    def parse(cls, line: str) -> Request:
        """Read a line."""
        verb, wait, *numbers = line.split()
        period_ns, *rest = map(int, numbers)
        return cls(verb, wait, period_ns, tuple(rest))


@dataclass(frozen=True)
class Operations:
    """What the loops call; the fewer Python frames lie behind these, the less else is measured.

    Attributes:
        send: Hands a record to the other side.
        poll: Fills a record if something new has arrived; what it returns is then true.
        wake: Wakes the other side; called after sending, when it blocks.
        wait: Waits until the other side has woken this one.
    """

    send: Callable[[bytearray], object]
    poll: Callable[[bytearray], object]
    wake: Callable[[], object]
    wait: Callable[[], object]


class Transport:
    """What carries 100 numbers; a contender overrides the methods below.

    Attributes:
        record: 200 bytes: what is sent, and where what is received goes.
        values: The same memory as numbers.
    """

    def __init__(self) -> None:
        self.record = bytearray(2 * COUNT)
        self.values: Numbers = np.frombuffer(self.record, dtype=np.uint16)

    def operations(self) -> Operations:
        """Return what the loops call."""
        return Operations(self.send, self.poll, self.wake, self.wait)

    def begin(self) -> None:
        """Make ready; called before each request is carried out, when both sides exist."""

    def send(self, record: bytearray) -> None:
        """Hand the record to the other side."""
        raise NotImplementedError

    def poll(self, record: bytearray) -> bool:
        """Fill the record if something new has arrived; return whether it has."""
        raise NotImplementedError

    def wake(self) -> None:
        """Wake the other side."""

    def wait(self) -> None:
        """Wait until the other side has woken this one."""

    def close(self) -> None:
        """Release everything."""


def report(line: str) -> None:
    """Print a line for the program that measures."""
    sys.stdout.write(line + "\n")
    sys.stdout.flush()


def read_requests() -> Iterator[Request]:
    """Yield requests until the input ends; a watchdog ends one that hangs."""
    for line in sys.stdin:
        signal.alarm(_WATCHDOG)
        yield Request.parse(line)
        signal.alarm(0)


def ticks_ahead(period_ns: int, phase_ns: int) -> float:
    """Return the seconds from now to the next tick of an absolute grid."""
    return (period_ns - (time.monotonic_ns() - phase_ns) % period_ns) / 1e9


def serve(side: str, transport: Transport) -> None:
    """Carry out requests until they end."""
    report("ready")
    for request in read_requests():
        phase_ns = request.period_ns // 2 if side == "B" else 0
        transport.begin()
        exchange = _exchange(transport, request, phase_ns)
        if request.verb == "answer":
            report("answering")
            exchange(request.numbers[0], False)
        else:
            warmup, repeats, *cycles = request.numbers
            if request.wait == "cycle":
                time.sleep(ticks_ahead(request.period_ns, phase_ns))
            _measure(transport, exchange, warmup, repeats, cycles)
    transport.close()


Exchange: TypeAlias = Callable[[int, bool], list[int]]
"""Runs so many cycles, as A (True: sends first, and returns the clock after each) or as B."""


def _exchange(transport: Transport, request: Request, phase_ns: int) -> Exchange:
    """Return the loop of one way to wait; each is written out, so that no frame but the calls is measured."""
    operations, record, values = transport.operations(), transport.record, transport.values
    send, poll, now = operations.send, operations.poll, time.perf_counter_ns
    wake, wait = operations.wake, operations.wait
    # An array and not a scalar: numpy would convert a scalar each time, which takes as long as the addition.
    add, ones = np.add, np.ones(COUNT, dtype=np.uint16)
    cyclic = request.wait == "cycle"

    def pause() -> None:
        if cyclic:
            time.sleep(ticks_ahead(request.period_ns, phase_ns))
        else:
            os.sched_yield()  # time.sleep(0) would cost the timer's slack

    def spinning(count: int, first: bool) -> list[int]:
        clock = [now()]
        note = clock.append
        if first:
            for _ in range(count):
                send(record)
                while not poll(record):
                    pass
                add(values, ones, values)
                note(now())
        else:
            for _ in range(count):
                while not poll(record):
                    pass
                add(values, ones, values)
                send(record)
        return clock

    def blocking(count: int, first: bool) -> list[int]:
        clock = [now()]
        note = clock.append
        if first:
            for _ in range(count):
                send(record)
                wake()
                wait()
                while not poll(record):
                    wait()
                add(values, ones, values)
                note(now())
        else:
            for _ in range(count):
                wait()
                while not poll(record):
                    wait()
                add(values, ones, values)
                send(record)
                wake()
        return clock

    def pausing(count: int, first: bool) -> list[int]:
        clock = [now()]
        for _ in range(count):
            if first:
                send(record)
            if cyclic:
                pause()
            while not poll(record):
                pause()
            add(values, ones, values)
            if first:
                clock.append(now())
            else:
                send(record)
        return clock

    return {"spin": spinning, "block": blocking}.get(request.wait, pausing)


def _measure(
    transport: Transport, exchange: Exchange, warmup: int, repeats: int, cycles: Sequence[int]
) -> None:
    spent: list[int] = []
    durations: list[list[int]] = []
    wrong = 0
    transport.values[:] = 0
    exchange(warmup, True)
    for _ in range(repeats):
        durations.append([])
        for count in cycles:
            transport.values[:] = 0
            clock = exchange(count, True)
            spent += [after - before for before, after in itertools.pairwise(clock)]
            durations[-1].append(clock[-1] - clock[0])
            wrong += not bool((transport.values == np.uint16(2 * count % 65536)).all())
    report(json.dumps({"runs": repeats * len(cycles), "wrong": wrong, "durations_ns": durations}))
    report(json.dumps(spent))


class ServerLoop:
    """Requests beside a server's event loop: its program works at once, or in its own cycle.

    Args:
        work: Answers what has been written; called with nothing.

    Attributes:
        cyclic: Whether the program works in its cycle; else the server calls it itself.
    """

    def __init__(self, work: Callable[[], object]) -> None:
        self.cyclic = False
        self._work = work
        self._request = Request("answer", "block", 0, ())
        self._task: asyncio.Task[None] | None = None
        self.ended = asyncio.Event()

    def listen(self) -> None:
        """Take requests from now on, in the running loop."""
        asyncio.get_running_loop().add_reader(sys.stdin.fileno(), self._read)

    def _read(self) -> None:
        data = os.read(sys.stdin.fileno(), 4096)
        if not data:
            self.ended.set()
            return
        self._request = Request.parse(data.decode())
        self.cyclic = self._request.wait == "cycle"
        if self._task is not None:
            self._task.cancel()
            self._task = None
        if self.cyclic:
            self._task = asyncio.get_running_loop().create_task(self._cycle())
        report("answering")

    async def _cycle(self) -> None:
        period_ns = self._request.period_ns
        while True:
            await asyncio.sleep(ticks_ahead(period_ns, period_ns // 2))
            done = self._work()
            if asyncio.iscoroutine(done):
                await done
