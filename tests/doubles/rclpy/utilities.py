"""rclpy/utilities.py."""

from __future__ import annotations

from rclpy.context import Context

_default: list[Context] = []


def get_default_context(*, shutting_down: bool = False) -> Context:
    import rclpy

    rclpy.USED_PROCESS_WIDE.append("default context")
    if not _default or (not shutting_down and _default[0]._state == "shut down"):
        _default[:] = [Context()]
    return _default[0]


def try_shutdown(*, context: Context | None = None) -> None:
    (get_default_context() if context is None else context).try_shutdown()
