"""How tests, campaigns and measurements wait for something that another thread or process does."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import TypeVar

__all__ = ["WATCHDOG_S", "repeat_until", "wait_for"]

T = TypeVar("T")

WATCHDOG_S = 100.0
"""When waiting fails: so late that a busy machine gets there, and before pytest's own limit ends the test."""


def wait_for(
    condition: Callable[[], T], what: str = "", *, seconds: float = WATCHDOG_S, every: float = 0.01
) -> T:
    """Return the condition's first true value; fail with ``what`` if none comes.

    Args:
        condition: What is asked again and again.
        what: What is waited for, for the failure's text.
        seconds: When to give up.
        every: Seconds between two questions.
    """
    end = time.monotonic() + seconds
    while not (value := condition()):
        if time.monotonic() > end:
            raise AssertionError(f"still waiting for {what or condition} after {seconds:.0f} s: {value!r}")
        time.sleep(every)
    return value


def repeat_until(
    act: Callable[[], object], condition: Callable[[], T], what: str = "", *, every: float = 0.05
) -> T:
    """Act again and again until the condition is true, for what may be lost on its way; return its value."""

    def acted() -> T:
        if not (value := condition()):
            act()
        return value

    return wait_for(acted, what, every=every)
