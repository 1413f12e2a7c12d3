"""The experiment's two sides in Python: ``c/exchange.h`` in another language, with the same orders."""

from __future__ import annotations

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

__all__ = [
    "COUNT",
    "Numbers",
    "Operations",
    "Order",
    "Transport",
    "read_orders",
    "say",
    "serve",
    "ticks_ahead",
]

Numbers: TypeAlias = NDArray[np.uint16]

COUNT = 100
"""Numbers of 16 bits that each message holds."""

_WATCHDOG = 300


@dataclass(frozen=True)
class Order:
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
    def parse(cls, line: str) -> Order:
        """Read a line."""
        verb, wait, *numbers = line.split()
        period_ns, *rest = map(int, numbers)
        return cls(verb, wait, period_ns, tuple(rest))


@dataclass(frozen=True)
class Operations:
    """What the loops call; the fewer Python frames lie behind these, the less else is measured.

    Attributes:
        send: Hands a record to the other side.
        attempt: Fills a record if something new is there; what it returns is then true.
        ring: Wakes the other side; called after sending, when it blocks.
        sleep: Waits until the other side has rung.
    """

    send: Callable[[bytearray], object]
    attempt: Callable[[bytearray], object]
    ring: Callable[[], object]
    sleep: Callable[[], object]


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
        return Operations(self.send, self.attempt, self.ring, self.sleep)

    def begin(self) -> None:
        """Make ready; called before each order is carried out, when both sides exist."""

    def send(self, record: bytearray) -> None:
        """Hand the record to the other side."""
        raise NotImplementedError

    def attempt(self, record: bytearray) -> bool:
        """Fill the record if something new is there, and say so."""
        raise NotImplementedError

    def ring(self) -> None:
        """Wake the other side."""

    def sleep(self) -> None:
        """Wait until the other side has rung."""

    def close(self) -> None:
        """Let go of everything."""


def say(line: str) -> None:
    """Print a line for the program that measures."""
    sys.stdout.write(line + "\n")
    sys.stdout.flush()


def read_orders() -> Iterator[Order]:
    """Yield orders until the input ends; none of them may take for ever."""
    for line in sys.stdin:
        signal.alarm(_WATCHDOG)
        yield Order.parse(line)
        signal.alarm(0)


def ticks_ahead(period_ns: int, phase_ns: int) -> float:
    """Return the seconds from now to the next tick of an absolute grid."""
    return (period_ns - (time.monotonic_ns() - phase_ns) % period_ns) / 1e9


def serve(side: str, transport: Transport) -> None:
    """Do what the orders say, until they end."""
    say("ready")
    for order in read_orders():
        phase_ns = order.period_ns // 2 if side == "B" else 0
        transport.begin()
        exchange = _EXCHANGES.get(order.wait, _exchange_cyclic)(transport, order.period_ns, phase_ns)
        if order.verb == "answer":
            say("answering")
            exchange(order.numbers[0], False)
        else:
            warmup, repeats, *cycles = order.numbers
            if order.wait == "cycle":
                time.sleep(ticks_ahead(order.period_ns, phase_ns))
            _measure(transport, exchange, warmup, repeats, cycles)
    transport.close()


Exchange: TypeAlias = Callable[[int, bool], list[int]]
"""Runs so many cycles, as A (True: sends first, and returns the clock after each) or as B."""


def _ones() -> Numbers:
    # An array and not a scalar: numpy would convert that anew each time, which takes as long as the addition.
    return np.ones(COUNT, dtype=np.uint16)


def _exchange_spinning(transport: Transport, period_ns: int, phase_ns: int) -> Exchange:
    operations, record, values = transport.operations(), transport.record, transport.values
    send, attempt, now = operations.send, operations.attempt, time.perf_counter_ns
    add, ones = np.add, _ones()

    def exchange(count: int, first: bool) -> list[int]:
        clock = [now()]
        note = clock.append
        if first:
            for _ in range(count):
                send(record)
                while not attempt(record):
                    pass
                add(values, ones, values)
                note(now())
        else:
            for _ in range(count):
                while not attempt(record):
                    pass
                add(values, ones, values)
                send(record)
        return clock

    return exchange


def _exchange_blocking(transport: Transport, period_ns: int, phase_ns: int) -> Exchange:
    operations, record, values = transport.operations(), transport.record, transport.values
    send, attempt, now = operations.send, operations.attempt, time.perf_counter_ns
    add, ones = np.add, _ones()
    ring, sleep = operations.ring, operations.sleep

    def exchange(count: int, first: bool) -> list[int]:
        clock = [now()]
        note = clock.append
        if first:
            for _ in range(count):
                send(record)
                ring()
                sleep()
                while not attempt(record):
                    sleep()
                add(values, ones, values)
                note(now())
        else:
            for _ in range(count):
                sleep()
                while not attempt(record):
                    sleep()
                add(values, ones, values)
                send(record)
                ring()
        return clock

    return exchange


def _exchange_cyclic(transport: Transport, period_ns: int, phase_ns: int) -> Exchange:
    def to_tick() -> None:
        time.sleep(ticks_ahead(period_ns, phase_ns))

    return _exchange_pausing(transport, to_tick, before=True)


def _exchange_yielding(transport: Transport, period_ns: int, phase_ns: int) -> Exchange:
    # time.sleep(0) would cost the timer's slack
    return _exchange_pausing(transport, os.sched_yield, before=False)


def _exchange_pausing(transport: Transport, pause: Callable[[], object], *, before: bool) -> Exchange:
    operations, record, values = transport.operations(), transport.record, transport.values
    send, attempt, now = operations.send, operations.attempt, time.perf_counter_ns
    add, ones = np.add, _ones()

    def receive() -> None:
        if before:
            pause()
        while not attempt(record):
            pause()
        add(values, ones, values)

    def exchange(count: int, first: bool) -> list[int]:
        clock = [now()]
        for _ in range(count):
            if first:
                send(record)
                receive()
                clock.append(now())
            else:
                receive()
                send(record)
        return clock

    return exchange


_EXCHANGES = {"spin": _exchange_spinning, "block": _exchange_blocking, "yield": _exchange_yielding}


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
    say(json.dumps({"runs": repeats * len(cycles), "wrong": wrong, "durations_ns": durations}))
    say(json.dumps(spent))
