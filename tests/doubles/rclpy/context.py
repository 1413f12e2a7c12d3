"""rclpy/context.py."""

from __future__ import annotations

import os
from collections.abc import Callable
from typing import Any

from rclpy import _graph
from rclpy._handles import Destroyable, RCLError


class _Handle(Destroyable):
    def __init__(self, context: Context) -> None:
        super().__init__(lambda: None)
        self.valid = context.ok


class Context:
    def __init__(self) -> None:
        self._state = "new"
        self._callbacks: list[Callable[[], None]] = []
        self._domain = 0
        self._arguments: list[str] = []

    def init(
        self, args: list[str] | None = None, *, initialize_logging: bool = True, domain_id: int | None = None
    ) -> None:
        if domain_id is not None and domain_id < 0:
            raise RuntimeError(f"Domain id ({domain_id}) should not be lower than zero.")
        if self._state != "new":
            raise RuntimeError("Context.init() must only be called once")
        if args is None:
            import rclpy

            rclpy.USED_PROCESS_WIDE.append("sys.argv")
        self._arguments = _ros_arguments(args or [])
        text = os.environ.get("ROS_DOMAIN_ID") or "0"
        if domain_id is None and not text.isdigit():
            raise RCLError("failed to initialize rcl: ROS_DOMAIN_ID is not an integral number")
        self._domain = int(text) if domain_id is None else domain_id
        if self._domain > 232:
            raise RCLError("failed to create domain, error Error")
        self._state = "ok"

    def ok(self) -> bool:
        return self._state == "ok"

    def shutdown(self) -> None:
        if self._state == "new":
            raise RuntimeError("Context must be initialized before it can be shutdown")
        if self._state != "ok":
            raise RCLError("Context already shutdown")
        self.try_shutdown()

    def try_shutdown(self) -> None:
        if self._state != "ok":
            return
        self._state = "shut down"
        callbacks, self._callbacks = self._callbacks, []
        for callback in callbacks:
            callback()
        with _graph.changed:
            _graph.changed.notify_all()

    @property
    def handle(self) -> Any:
        return _Handle(self)

    def on_shutdown(self, callback: Callable[[], None]) -> None:
        self._callbacks.append(callback)

    def get_domain_id(self) -> int:
        if self._state == "new":
            raise RuntimeError("Context must be initialized before it can have a domain id")
        return self._domain


# rcl/include/rcl/arguments.h
_PAIRS = {
    "-r", "--remap", "-p", "--param", "--params-file", "-e", "--enclave", "--log-level", "--log-config-file",
}  # fmt: skip
_LOGS = ("rosout-logs", "stdout-logs", "external-lib-logs")
_FLAGS = {f"--{word}-{what}" for word in ("enable", "disable") for what in _LOGS}


def _ros_arguments(args: list[str]) -> list[str]:
    """Return what stands between --ros-args and --; unknown words there are an error, as in rcl."""
    inside, found, rest = False, [], iter(args)
    for word in rest:
        if word in ("--ros-args", "--"):
            inside = word == "--ros-args"
        elif inside and word in _PAIRS:
            found += [word, next(rest)]
        elif inside and word in _FLAGS:
            continue
        elif inside:
            raise RCLError(f"Failed to parse global arguments: unknown ROS argument {word}")
    return found
