"""Two threads beside the data path: one beats and looks after objects, one asks ROS and reports."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable

from rosplc.bridge.status import BridgeStatus
from rosplc.bridge.topic import log
from rosplc.errors import RosplcError

__all__ = ["Keeper", "Observer"]

_CHECK_NS = 1_000_000_000
_PATIENCE_S = 5.0


class _Thread:
    """A thread that can be asked to stop, and whose work may fail without ending it."""

    def __init__(self, name: str) -> None:
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


class Keeper(_Thread):
    """Beats, checks once a second, and sends messages that waited for their time.

    Args:
        beat_ns: Time between two beats.
        beat: Beats on all lines.
        check: Looks after the objects; gets the time.
        flush: Sends what is due; gets the time and returns when it is wanted next.

    Attributes:
        turned_ns: When it last began a round, at least one a second.
    """

    def __init__(
        self,
        beat_ns: int,
        beat: Callable[[], None],
        check: Callable[[int], None],
        flush: Callable[[int], int | None],
    ) -> None:
        super().__init__("rosplc-keeper")
        self._beat_ns = beat_ns
        self._beat, self._check, self._flush = beat, check, flush
        self._due_ns: int | None = None
        self.turned_ns = time.monotonic_ns()

    def due(self, _when_ns: int) -> None:
        """A message waits for its time: look again; from any thread."""
        self._wake.set()

    def _run(self) -> None:
        beat_at = check_at = time.monotonic_ns()
        while not self._stopping:
            self.turned_ns = now = time.monotonic_ns()
            if now >= beat_at:
                self._guard("beating", self._beat)
                # A machine that was suspended owes no beats.
                beat_at = max(beat_at + self._beat_ns, now)
            if now >= check_at:
                self._guard("checking", lambda: self._check(time.monotonic_ns()))
                check_at = now + _CHECK_NS
            self._due_ns = None
            self._guard("sending what waited", self._send)
            next_at = min(beat_at, check_at)
            if self._due_ns is not None:
                next_at = min(next_at, self._due_ns)
            self._wake.wait(max(0, next_at - time.monotonic_ns()) / 1e9)
            self._wake.clear()

    def _send(self) -> None:
        self._due_ns = self._flush(time.monotonic_ns())


class Observer(_Thread):
    """Asks the ROS side once a second, and publishes the status.

    Args:
        period_ns: Time between two publications.
        ask: Asks how the topics stand; gets the time.
        status: Returns the bridge's status.
        publish: Sends it; None where nobody wants it.
    """

    def __init__(
        self,
        period_ns: int,
        ask: Callable[[int], None],
        status: Callable[[], BridgeStatus],
        publish: Callable[[BridgeStatus], None] | None,
    ) -> None:
        super().__init__("rosplc-observer")
        self._period_ns = period_ns
        self._ask, self._status, self._publish = ask, status, publish

    def _run(self) -> None:
        ask_at = time.monotonic_ns()
        report_at = ask_at + self._period_ns
        while not self._stopping:
            now = time.monotonic_ns()
            if now >= ask_at:
                self._guard("asking ROS", lambda: self._ask(time.monotonic_ns()))
                ask_at = now + _CHECK_NS
            if now >= report_at:
                if (publish := self._publish) is not None:
                    self._guard("reporting", lambda publish=publish: publish(self._status()))  # type: ignore[misc]
                report_at = now + self._period_ns
            self._wake.wait(max(0, min(ask_at, report_at) - time.monotonic_ns()) / 1e9)
