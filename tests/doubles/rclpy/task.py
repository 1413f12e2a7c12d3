"""rclpy/task.py, as far as Executor.create_task and Client.call_async return it."""

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

    def result(self) -> None:
        if self._exception is not None:
            raise self._exception

    def exception(self) -> Exception | None:
        return self._exception


class Future:
    def __init__(self, *, executor: Any = None) -> None:
        self._done = False
        self._result: Any = None
        self._callbacks: list[Callable[[Future], None]] = []
        self._executor = executor

    def done(self) -> bool:
        return self._done

    def result(self) -> Any:
        return self._result

    def set_result(self, result: Any) -> None:
        self._result, self._done = result, True
        for callback in self._callbacks:
            self._executor.create_task(callback, self)

    def _set_executor(self, executor: Any) -> None:
        self._executor = executor

    def add_done_callback(self, callback: Callable[[Future], None]) -> None:
        if self._done:
            self._executor.create_task(callback, self)
        else:
            self._callbacks.append(callback)
