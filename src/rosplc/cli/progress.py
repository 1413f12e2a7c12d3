"""A line that says how long work stands: rewritten in a terminal, now and then in a log."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable

from rosplc.cli.text import harmless

__all__ = ["ProgressLine"]

_TERMINAL_S = 1.0
_LOG_S = 10.0


class ProgressLine:
    """Progress on stderr.

    Args:
        quiet: Show nothing.
    """

    def __init__(self, *, quiet: bool = False) -> None:
        self._quiet = quiet
        self._terminal = sys.stderr.isatty()
        self._period = _TERMINAL_S if self._terminal else _LOG_S
        self._next = time.monotonic() + self._period
        self._shown = 0

    def show(self, text: Callable[[], str]) -> None:
        """Show how it stands, if it is time."""
        now = time.monotonic()
        if self._quiet or now < self._next:
            return
        self._next = now + self._period
        line = harmless(text())
        if self._terminal:
            sys.stderr.write("\r" + line.ljust(self._shown))
            self._shown = len(line)
        else:
            sys.stderr.write(line + "\n")
        sys.stderr.flush()

    def clear(self) -> None:
        """Remove the line, so that other output can follow."""
        if self._shown:
            sys.stderr.write("\r" + " " * self._shown + "\r")
            sys.stderr.flush()
            self._shown = 0
