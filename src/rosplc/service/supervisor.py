"""Reports from a running bridge to systemd, whose watchdog is reset only while messages can be carried.

A service reports with a datagram of ``KEY=value`` lines to the socket in ``NOTIFY_SOCKET`` (sd_notify(3)).
A library would have more code than this module, or require a C library that a wheel cannot rely on.
"""

from __future__ import annotations

import logging
import os
import socket
import threading
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress

from rosplc.bridge.engine import Bridge
from rosplc.bridge.status import BridgeStatus

log = logging.getLogger("rosplc.service")

_START_S = 0.1
_STATUS_S = 5.0
_LEAST_S = 0.05


class Notifier:
    """The connection to the service manager that started this process; does nothing without one.

    ``address`` is ``NOTIFY_SOCKET``, empty without a service manager; ``watchdog_s`` is the longest interval
    in seconds between two watchdog messages that systemd tolerates, 0 for no watchdog.
    """

    def __init__(self, address: str = "", watchdog_s: float = 0.0) -> None:
        self.watchdog_s = watchdog_s
        # A leading @ stands for the abstract namespace, which the kernel writes as a NUL.
        self.address = "\0" + address[1:] if address.startswith("@") else address

    @classmethod
    def of(cls, environment: Mapping[str, str] | None = None) -> Notifier:
        """Return the notifier that the environment describes; None: the environment of this process."""
        if environment is None:
            environment = os.environ
        try:
            micros = int(environment.get("WATCHDOG_USEC", "0"))
            pid = int(environment.get("WATCHDOG_PID", str(os.getpid())))
        except ValueError:
            micros, pid = 0, os.getpid()
        # Children inherit the environment; the watchdog is the main process's.
        return cls(environment.get("NOTIFY_SOCKET", ""), micros / 1e6 if pid == os.getpid() else 0.0)

    def tell(self, message: str) -> None:
        """Send lines of ``KEY=value``."""
        if not self.address:
            return
        with (
            suppress(OSError),  # a manager that does not listen stops no bridge
            socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM | socket.SOCK_CLOEXEC) as unix,
        ):
            unix.setblocking(False)
            unix.sendto(message.encode(), self.address)


class Supervisor:
    """Reports a bridge's state to the service manager."""

    def __init__(self, bridge: Bridge, notifier: Notifier) -> None:
        self._bridge = bridge
        self._notifier = notifier
        watchdog = notifier.watchdog_s
        self._period_s = min(_STATUS_S, max(_LEAST_S, watchdog / 4)) if watchdog else _STATUS_S
        # Half of the watchdog's time, so that a round that is merely slow ends before it does.
        self._longest_ns = int(watchdog / 2 * 1e9)
        self._stuck = ""
        self._running = False

    def look(self) -> float:
        """Report changes, and reset the watchdog unless the bridge is stuck; return the seconds to wait."""
        status = self._bridge.status()
        if not status.running:
            # Before the start, or after the end began: systemd has other times for these.
            self.ended()
            return _START_S
        if not self._running:
            self._running = True
            self._notifier.tell(f"READY=1\nSTATUS={_in_words(status)}")
        stuck = self._bridge.stuck(self._longest_ns) if self._longest_ns else ""
        self._notifier.tell(f"STATUS={' '.join(stuck.split()) or _in_words(status)}")
        if not stuck:
            self._notifier.tell("WATCHDOG=1")  # systemd restarts what feeds its watchdog no more
        elif not self._stuck:
            log.error("%s; systemd will restart the bridge unless it recovers", stuck)
        self._stuck = stuck
        return self._period_s

    def ended(self) -> None:
        """Report that the bridge is stopping, if it was running."""
        if self._running:
            self._notifier.tell("STOPPING=1")
        self._running = False

    def run(self, stop: threading.Event) -> None:
        """Report until ``stop`` is set."""
        while not stop.wait(self._guarded()):
            pass
        self.ended()

    def _guarded(self) -> float:
        try:
            return self.look()
        except Exception:  # a defect here must show itself, and not end the looking
            log.exception("cannot report the state of the bridge to systemd")
            return self._period_s


@contextmanager
def supervised(bridge: Bridge, environment: Mapping[str, str] | None = None) -> Iterator[None]:
    """Report a bridge's state to the service manager, if any; the bridge may start and stop inside."""
    notifier = Notifier.of(environment)
    if not notifier.address:
        yield
        return
    stop = threading.Event()
    supervisor = Supervisor(bridge, notifier)
    thread = threading.Thread(target=supervisor.run, args=(stop,), name="rosplc-supervisor", daemon=True)
    thread.start()
    try:
        yield
    finally:
        stop.set()
        thread.join(_STATUS_S)


def _in_words(status: BridgeStatus) -> str:
    fine = sum(topic.judgement[0] == 0 for topic in status.topics)
    received = sum(topic.received for topic in status.topics)
    published = sum(topic.published for topic in status.topics)
    text = f"{fine} of {len(status.topics)} topics fine over {status.backend}; in {received}, out {published}"
    uses = (*status.services, *status.actions)
    well = sum(use.judgement[0] == 0 for use in uses)
    calls = [f"{well} of {len(uses)} services and actions fine"] if uses else []
    return " ".join("; ".join((text, *calls, *status.notes)).split())
