"""Handles as rclpy's C++ part has them (src/rclpy/destroyable.cpp): counted, destroyed when not in use."""

from __future__ import annotations

import threading
from collections.abc import Callable


class InvalidHandle(RuntimeError):
    pass


class RCLError(RuntimeError):
    pass


class NodeNameNonExistentError(RCLError):
    pass


class UnsupportedEventTypeError(RCLError):
    pass


class Destroyable:
    def __init__(self, destroy: Callable[[], None]) -> None:
        self._destroy = destroy
        self._uses = 0
        self._doomed = False
        self._guard = threading.RLock()

    @property
    def pointer(self) -> int:
        return id(self)

    def __enter__(self) -> None:
        with self._guard:
            if self._doomed:
                raise InvalidHandle("cannot use Destroyable because destruction was requested")
            self._uses += 1

    def __exit__(self, *_: object) -> None:
        with self._guard:
            self._uses -= 1
            if not self._doomed or self._uses:
                return
        self._destroy()

    def destroy_when_not_in_use(self) -> None:
        with self._guard:
            if self._doomed:
                return
            self._doomed = True
            if self._uses:
                return
        self._destroy()
