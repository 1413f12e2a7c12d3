"""The clock that carrying, backends and recorder are given; tests give one that they step."""

from __future__ import annotations

import threading
import time
from typing import Protocol


class Clock(Protocol):
    """Time, and waiting for it."""

    def monotonic_ns(self) -> int:
        """Return nanoseconds since some fixed moment; never goes back."""

    def time_ns(self) -> int:
        """Return nanoseconds since 1970, for stamps."""

    def wait(self, event: threading.Event, timeout_ns: int | None = None) -> bool:
        """Wait until ``event`` is set, for ``timeout_ns`` at most; return whether it is set."""

    def sleep(self, duration_ns: int) -> None:
        """Do nothing for a while."""


class SystemClock:
    """The machine's clock."""

    monotonic_ns = staticmethod(time.monotonic_ns)
    time_ns = staticmethod(time.time_ns)

    @staticmethod
    def wait(event: threading.Event, timeout_ns: int | None = None) -> bool:
        """Wait until ``event`` is set, for ``timeout_ns`` at most; return whether it is set."""
        return event.wait(None if timeout_ns is None else max(0, timeout_ns) / 1e9)

    @staticmethod
    def sleep(duration_ns: int) -> None:
        """Do nothing for a while."""
        time.sleep(max(0, duration_ns) / 1e9)


SYSTEM: Clock = SystemClock()
"""The default wherever a clock can be given."""
