"""What a service tells systemd: ready, alive, and how it stands (sd_notify(3)).

The protocol is one datagram of ``KEY=value`` lines to the socket that ``NOTIFY_SOCKET`` names. The
libraries for it bring more code than these lines, or a C library that a wheel cannot count on.
"""

from __future__ import annotations

import os
import socket
from collections.abc import Mapping

__all__ = ["Notifier"]


class Notifier:
    """The way to the service manager that started this process; silent where there is none.

    Args:
        address: ``NOTIFY_SOCKET``; empty for nobody.
        watchdog_s: How often systemd wants to hear of us at least, in seconds; 0 if it does not.
    """

    def __init__(self, address: str = "", watchdog_s: float = 0.0) -> None:
        self.watchdog_s = watchdog_s
        # A leading @ stands for the abstract namespace, which the kernel writes as a NUL.
        self._address = "\0" + address[1:] if address.startswith("@") else address

    @property
    def wanted(self) -> bool:
        """Whether a service manager listens."""
        return bool(self._address)

    @classmethod
    def of(cls, environment: Mapping[str, str] | None = None) -> Notifier:
        """Return the way that the environment describes; None for the process's own."""
        if environment is None:
            environment = os.environ
        try:
            micros = int(environment.get("WATCHDOG_USEC", "0"))
            pid = int(environment.get("WATCHDOG_PID", str(os.getpid())))
        except ValueError:
            micros, pid = 0, os.getpid()
        # Children inherit the environment; the watchdog is the main process's.
        return cls(environment.get("NOTIFY_SOCKET", ""), micros / 1e6 if pid == os.getpid() else 0.0)

    def ready(self, status: str) -> None:
        """Say that everything is open and carries."""
        self._send(f"READY=1\nSTATUS={_one_line(status)}")

    def stopping(self) -> None:
        """Say that the end has begun."""
        self._send("STOPPING=1")

    def status(self, text: str) -> None:
        """Say how the service stands, for ``systemctl status``."""
        self._send(f"STATUS={_one_line(text)}")

    def alive(self) -> None:
        """Feed the watchdog."""
        self._send("WATCHDOG=1")

    def _send(self, message: str) -> None:
        if not self._address:
            return
        with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM | socket.SOCK_CLOEXEC) as unix:
            unix.setblocking(False)  # a manager that does not listen stops no bridge
            try:
                unix.sendto(message.encode(), self._address)
            except OSError:
                return


def _one_line(text: str) -> str:
    return " ".join(text.split())
