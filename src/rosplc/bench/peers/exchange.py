"""The experiment's two sides in Python: ``c/exchange.h`` in another language, with the same orders."""

from __future__ import annotations

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

__all__ = ["COUNT", "Numbers", "Order", "Transport", "read_orders", "say", "serve", "ticks_ahead"]

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


class Transport:
    """What carries 100 numbers; a contender overrides the four methods.

    Attributes:
        record: 200 bytes: what is sent, and where what is received goes.
        values: The same memory as numbers.
    """

    def __init__(self) -> None:
        self.record = bytearray(2 * COUNT)
        self.values: Numbers = np.frombuffer(self.record, dtype=np.uint16)

    def begin(self) -> None:
        """Make ready; called before each order is carried out, when both sides exist."""

    def send(self) -> None:
        """Hand the record to the other side."""
        raise NotImplementedError

    def attempt(self) -> bool:
        """Fill the record if something new is there, and say so."""
        raise NotImplementedError

    def ring(self) -> None:
        """Wake the other side; called after sending, when it blocks."""

    def sleep(self) -> None:
        """Wait until the other side has rung."""

    def sender(self) -> Callable[[], object]:
        """Return what sends the record, with as few calls as will do."""
        return self.send

    def spin(self) -> None:
        """Fill the record, looking again at once. Overridden where fewer calls will do."""
        attempt = self.attempt
        while not attempt():
            pass

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
        send, receive = _ways(transport, order, phase_ns)
        if order.verb == "answer":
            _answer(transport, send, receive, order.numbers[0])
        else:
            warmup, repeats, *cycles = order.numbers
            if order.wait == "cycle":
                time.sleep(ticks_ahead(order.period_ns, phase_ns))
            _measure(transport, send, receive, warmup, repeats, cycles)
    transport.close()


def _ways(
    transport: Transport, order: Order, phase_ns: int
) -> tuple[Callable[[], object], Callable[[], None]]:
    attempt, ring, sleep = transport.attempt, transport.ring, transport.sleep
    send = transport.sender()

    def send_and_ring() -> None:
        send()
        ring()

    def give_away() -> None:
        while not attempt():
            os.sched_yield()  # time.sleep(0) would cost the timer's slack

    def block() -> None:
        sleep()
        while not attempt():
            sleep()

    def once_per_period() -> None:
        time.sleep(ticks_ahead(order.period_ns, phase_ns))
        while not attempt():
            time.sleep(ticks_ahead(order.period_ns, phase_ns))

    receivers = {"spin": transport.spin, "yield": give_away, "block": block, "cycle": once_per_period}
    return (send_and_ring if order.wait == "block" else send), receivers[order.wait]


def _ones() -> Numbers:
    # An array and not a scalar: numpy would convert that anew each time, which takes as long as the addition.
    return np.ones(COUNT, dtype=np.uint16)


def _answer(
    transport: Transport, send: Callable[[], object], receive: Callable[[], None], total: int
) -> None:
    values, add, ones = transport.values, np.add, _ones()
    say("answering")
    for _ in range(total):
        receive()
        add(values, ones, values)
        send()


def _measure(
    transport: Transport,
    send: Callable[[], object],
    receive: Callable[[], None],
    warmup: int,
    repeats: int,
    cycles: Sequence[int],
) -> None:
    values, add, ones, now = transport.values, np.add, _ones(), time.perf_counter_ns
    spent: list[int] = []
    note = spent.append

    def run(count: int) -> int:
        values[:] = 0
        start = before = now()
        for _ in range(count):
            send()
            receive()
            add(values, ones, values)
            after = now()
            note(after - before)
            before = after
        return before - start

    run(warmup)
    spent.clear()
    durations: list[list[int]] = []
    wrong = 0
    for _ in range(repeats):
        durations.append([])
        for count in cycles:
            durations[-1].append(run(count))
            wrong += not bool((values == np.uint16(2 * count % 65536)).all())
    say(json.dumps({"runs": repeats * len(cycles), "wrong": wrong, "durations_ns": durations}))
    say(json.dumps(spent))
