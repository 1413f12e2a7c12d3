"""Two threads beside the data path: one beats and looks after objects, one asks ROS and reports."""

from __future__ import annotations

import threading
from collections.abc import Callable

from rosplc.bridge.port import log
from rosplc.bridge.status import BridgeStatus
from rosplc.clock import Clock
from rosplc.errors import RosplcError

__all__ = ["Heartbeat", "Reporter"]

_CHECK_NS = 1_000_000_000
_PATIENCE_S = 5.0


class _Thread:
    """A thread that can be asked to stop, and whose work may fail without ending it."""

    def __init__(self, name: str, clock: Clock) -> None:
        self._clock = clock
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
        raise NotImplementedError

    def _guard(self, what: str, work: Callable[[], None]) -> None:
        try:
            work()
        except RosplcError as error:
            log.warning("%s failed: %s", what, error)
        except Exception:
            log.exception("%s failed", what)


class Heartbeat(_Thread):
    """Beats, and checks once a second.

    Args:
        beat_ns: Time between two beats.
        beat: Beats on all lines.
        check: Looks after the objects; gets the time.
        clock: Time.

    Attributes:
        turned_ns: When it last began a round, at least one a second.
    """

    def __init__(
        self, beat_ns: int, beat: Callable[[], None], check: Callable[[int], None], clock: Clock
    ) -> None:
        super().__init__("rosplc-heartbeat", clock)
        self._beat_ns = beat_ns
        self._beat, self._check = beat, check
        self.turned_ns = clock.monotonic_ns()

    def _run(self) -> None:
        beat_at = check_at = self._clock.monotonic_ns()
        while not self._stopping:
            self.turned_ns = now = self._clock.monotonic_ns()
            if now >= beat_at:
                self._guard("beating", self._beat)
                # A machine that was suspended owes no beats.
                beat_at = max(beat_at + self._beat_ns, now)
            if now >= check_at:
                self._guard("checking", lambda: self._check(self._clock.monotonic_ns()))
                check_at = now + _CHECK_NS
            self._clock.wait(self._wake, min(beat_at, check_at) - self._clock.monotonic_ns())


class Reporter(_Thread):
    """Asks the ROS side once a second, and publishes the status.

    Args:
        period_ns: Time between two publications.
        ask: Asks how the topics stand; gets the time.
        status: Returns the bridge's status.
        publish: Sends it; None where it is not wanted.
        clock: Time.
    """

    def __init__(
        self,
        period_ns: int,
        ask: Callable[[int], None],
        status: Callable[[], BridgeStatus],
        publish: Callable[[BridgeStatus], None] | None,
        clock: Clock,
    ) -> None:
        super().__init__("rosplc-reporter", clock)
        self._period_ns = period_ns
        self._ask, self._status, self._publish = ask, status, publish

    def _run(self) -> None:
        ask_at = self._clock.monotonic_ns()
        report_at = ask_at + self._period_ns
        while not self._stopping:
            now = self._clock.monotonic_ns()
            if now >= ask_at:
                self._guard("asking ROS", lambda: self._ask(self._clock.monotonic_ns()))
                ask_at = now + _CHECK_NS
            if now >= report_at:
                if (publish := self._publish) is not None:
                    self._guard("reporting", lambda publish=publish: publish(self._status()))  # type: ignore[misc]
                report_at = now + self._period_ns
            self._clock.wait(self._wake, min(ask_at, report_at) - self._clock.monotonic_ns())
