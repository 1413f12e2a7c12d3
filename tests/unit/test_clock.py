"""The machine's clock and the one that tests step behave alike."""

from __future__ import annotations

import threading
import time

import pytest

from rosplc.clock import SYSTEM, Clock
from tests.lib.clock import SteppedClock


@pytest.mark.parametrize("clock", [SYSTEM, SteppedClock()], ids=["system", "stepped"])
def test_wait_returns_whether_the_event_is_set(clock: Clock) -> None:
    """A set event is seen at once, and a time that is over ends the wait."""
    event = threading.Event()
    assert not clock.wait(event, 0)
    event.set()
    assert clock.wait(event)


def test_system_clock_is_the_machines() -> None:
    """Its times are those of the standard library."""
    before, day = time.monotonic_ns(), time.time_ns()
    assert before <= SYSTEM.monotonic_ns() <= time.monotonic_ns()
    assert day <= SYSTEM.time_ns()
    SYSTEM.sleep(1_000_000)
    assert SYSTEM.monotonic_ns() >= before + 1_000_000


def test_threads_wait_for_the_stepped_time() -> None:
    """A sleeping thread continues once the clock was stepped far enough, and not before."""
    clock, order = SteppedClock(), list[int]()

    def work() -> None:
        clock.sleep(5_000_000_000)
        order.append(clock.monotonic_ns())

    start = clock.monotonic_ns()
    thread = threading.Thread(target=work)
    thread.start()
    clock.until_waiting()
    clock.advance(4.999)
    clock.until_waiting()
    assert order == []
    clock.advance(ns=1_000_000)
    thread.join(60)
    assert order == [start + 5_000_000_000]
    assert clock.time_ns() - clock.monotonic_ns() == SteppedClock().time_ns() - SteppedClock().monotonic_ns()
