"""rclpy/task.py, as far as Executor.create_task returns it."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any


class Task:
    def __init__(self, handler: Callable[..., Any], args: Any = None, kwargs: Any = None) -> None:
        self._call = (handler, args or (), kwargs or {})
        self._exception: Exception | None = None
        self._done = False

    def __call__(self) -> None:
        handler, args, kwargs = self._call
        try:
            handler(*args, **kwargs)
        except Exception as error:
            self._exception = error
        self._done = True

    def done(self) -> bool:
        return self._done

    def exception(self) -> Exception | None:
        return self._exception
