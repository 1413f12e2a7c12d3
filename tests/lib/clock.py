"""A clock that is stopped until a test steps it."""

from __future__ import annotations

import threading
import time

__all__ = ["SteppedClock"]

_WATCHDOG_S = 60.0


class SteppedClock:
    """A :class:`rosplc.clock.Clock` whose time passes in :meth:`advance` alone.

    Threads that wait on it sleep until their event is set or the stepped time has come.
    """

    def __init__(self, monotonic_ns: int = 10**12, time_ns: int = 1_700_000_000 * 10**9) -> None:
        self._now = monotonic_ns
        self._offset = time_ns - monotonic_ns
        self._changed = threading.Condition()
        self._waiting: dict[int, int | None] = {}  # by thread: until when

    def monotonic_ns(self) -> int:
        """Return the stepped time."""
        return self._now

    def time_ns(self) -> int:
        """Return the stepped time of day."""
        return self._now + self._offset

    def set_back(self, seconds: float) -> None:
        """Step the time of day, as an administrator does; a negative number sets it forward."""
        self._offset -= round(seconds * 1e9)

    def advance(self, seconds: float = 0.0, *, ns: int = 0) -> int:
        """Let time pass, wake who waited for it, and return the new monotonic time."""
        with self._changed:
            self._now += round(seconds * 1e9) + ns
            for thread, until in list(self._waiting.items()):
                if until is not None and until <= self._now:
                    del self._waiting[thread]
            self._changed.notify_all()
            return self._now

    def step(self, seconds: float) -> int:
        """As :meth:`advance`, and return once every thread that waited before waits again."""
        threads = len(self._waiting)
        now = self.advance(seconds)
        self.until_waiting(threads)
        return now

    def wait(self, event: threading.Event, timeout_ns: int | None = None) -> bool:
        """Wait until ``event`` is set or the stepped time has come; return whether it is set."""
        me = threading.get_ident()
        with self._changed:
            until = None if timeout_ns is None else self._now + timeout_ns
            self._waiting[me] = until
            self._changed.notify_all()
            while not event.is_set() and (until is None or self._now < until):
                self._changed.wait(0.002)  # the event does not notify this condition
            self._waiting.pop(me, None)
        return event.is_set()

    def sleep(self, duration_ns: int) -> None:
        """Wait until the stepped time has come."""
        self.wait(threading.Event(), duration_ns)

    @property
    def waiting(self) -> int:
        """How many threads wait for a time that has not come yet."""
        return len(self._waiting)

    def until_waiting(self, threads: int = 1) -> None:
        """Return once so many threads wait for a time that has not come yet.

        Raises:
            TimeoutError: They do not within a minute.
        """
        end = time.monotonic() + _WATCHDOG_S
        with self._changed:
            while len(self._waiting) < threads:
                if time.monotonic() > end:
                    raise TimeoutError(f"{len(self._waiting)} of {threads} threads wait")
                self._changed.wait(0.05)
