"""Work that one thread wants another to do between two of its turns."""

from __future__ import annotations

import threading
from collections.abc import Callable

__all__ = ["Order"]


class Order:
    """A piece of work, done by the thread that calls it, unless its giver has taken it back before.

    Args:
        work: What is to be done; it must not wait for anything.
    """

    def __init__(self, work: Callable[[], None]) -> None:
        self._work = work
        self._claim = threading.Lock()
        self._done = threading.Event()
        self._error: Exception | None = None

    def __call__(self) -> None:
        """Do the work, if it is still wanted."""
        if not self._claim.acquire(blocking=False):
            return
        try:
            self._work()
        except Exception as error:  # it is the giver's, not this thread's
            self._error = error
        self._done.set()

    def wait(self, timeout: float = 5.0) -> bool:
        """Wait until it is done; False if nobody began within ``timeout`` seconds: it is then taken back.

        Raises:
            Exception: What the work raised.
        """
        if not self._done.wait(timeout) and self._claim.acquire(blocking=False):
            return False
        self._done.wait()  # begun, and it waits for nothing
        if self._error is not None:
            raise self._error
        return True
