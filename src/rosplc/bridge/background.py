"""Threads beside the data path, which do something once in a while."""

from __future__ import annotations

import threading
from collections.abc import Callable
from dataclasses import dataclass

from rosplc.bridge.port import log
from rosplc.clock import Clock
from rosplc.errors import RosplcError

__all__ = ["Duty", "Rounds"]

_PATIENCE_S = 5.0


@dataclass
class Duty:
    """Something to be done once per period; when it fails it is logged, and done again.

    Attributes:
        what: In words, for the log.
        period_ns: Time between two times.
        work: Does it.
        due_ns: When it is due first, after the start; later the monotonic time.
    """

    what: str
    period_ns: int
    work: Callable[[], None]
    due_ns: int = 0


class Rounds:
    """A thread that looks after its duties.

    Args:
        name: The thread's.
        clock: Time.
        duties: What it does.

    Attributes:
        turned_ns: When it last began a round.
    """

    def __init__(self, name: str, clock: Clock, *duties: Duty) -> None:
        self._clock = clock
        self._duties = duties
        self.turned_ns = clock.monotonic_ns()
        self._wake = threading.Event()
        self._stopping = False
        self._thread = threading.Thread(target=self._run, name=name, daemon=True)

    def start(self) -> None:
        """Begin."""
        self._thread.start()

    def stop(self) -> None:
        """End; a thread that hangs in the ROS side is left behind after five seconds."""
        self._stopping = True
        self._wake.set()
        self._thread.join(_PATIENCE_S)
        if self._thread.is_alive():
            log.error("%s does not end; it is left behind", self._thread.name)

    def _run(self) -> None:
        for duty in self._duties:
            duty.due_ns += self._clock.monotonic_ns()
        while not self._stopping:
            self.turned_ns = now = self._clock.monotonic_ns()
            for duty in self._duties:
                if now >= duty.due_ns:
                    self._do(duty)
                    # A machine that was suspended owes nothing.
                    duty.due_ns = max(duty.due_ns + duty.period_ns, now)
            due = min(duty.due_ns for duty in self._duties)
            self._clock.wait(self._wake, due - self._clock.monotonic_ns())

    def _do(self, duty: Duty) -> None:
        try:
            duty.work()
        except RosplcError as error:
            log.warning("%s failed: %s", duty.what, error)
        except Exception:
            log.exception("%s failed", duty.what)
