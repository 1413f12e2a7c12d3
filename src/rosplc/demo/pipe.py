"""The line between the demonstration and its processes: JSON, one object per line.

A child reads orders from stdin and reports on stdout. The end of stdin means that the
parent is gone, whatever killed it, so no child outlives a demonstration.
"""

from __future__ import annotations

import json
import signal
import sys
import threading
from typing import Any

__all__ = ["Orders", "report"]

_lock = threading.Lock()


def report(kind: str, **facts: Any) -> None:
    """Send one report to the parent; a parent that is gone is noticed by :class:`Orders`."""
    line = json.dumps({"is": kind, **facts}) + "\n"
    with _lock:
        try:
            sys.stdout.write(line)
            sys.stdout.flush()
        except (BrokenPipeError, ValueError):
            pass


class Orders:
    """The parent's orders as events: ``go``, ``drain``, ``stop``, and others that are named.

    Constructing it makes the process deaf to Ctrl-C, which a terminal sends to the whole
    group: the parent decides what ends when.

    Args:
        others: More orders.

    Attributes:
        others: The event of each of them.
    """

    def __init__(self, *others: str) -> None:
        signal.signal(signal.SIGINT, signal.SIG_IGN)
        signal.signal(signal.SIGTERM, lambda *_: self.stop.set())
        self.go = threading.Event()
        self.drain = threading.Event()
        self.stop = threading.Event()
        self.others = {word: threading.Event() for word in others}
        threading.Thread(target=self._listen, name="orders", daemon=True).start()

    def _listen(self) -> None:
        events = {"go": self.go, "drain": self.drain, "stop": self.stop, **self.others}
        for line in sys.stdin:
            event = events.get(line.strip())
            if event is not None:
                event.set()
        self.stop.set()
