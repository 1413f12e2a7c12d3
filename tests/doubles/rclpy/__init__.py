"""A stand-in for rclpy, for machines without ROS 2: rclpy's own signatures over a graph in this process.

It is strict on purpose: what rclpy does not have, or not with these arguments, fails. The
signatures are held to a table that was written down from rclpy's sources
(``tests/doubles/rclpy_signatures.py``), by a test that holds an installed rclpy to the same table.
Behaviour follows rclpy 7.1.3 (Jazzy), and with ``ROS_DISTRO=humble`` when it is imported 3.3.15.

What it does not do: timers, parameter services, remapping of node names by launch files
other than ``__node`` and ``__ns``, and any message that is not raw bytes.
A service is two topics, as over DDS.
"""

from __future__ import annotations

from typing import Any

from rclpy import _messages
from rclpy.context import Context
from rclpy.utilities import get_default_context, try_shutdown

__all__ = ["init", "shutdown", "spin", "try_shutdown"]

_messages.install()

USED_PROCESS_WIDE: list[str] = []
"""What has touched the default context or the signal handlers of the process; for tests."""


def init(
    *,
    args: list[str] | None = None,
    context: Context | None = None,
    domain_id: int | None = None,
    signal_handler_options: Any = None,
) -> None:
    chosen = get_default_context() if context is None else context
    if context is None:
        USED_PROCESS_WIDE.append("init")
    chosen.init(args, domain_id=domain_id)


def shutdown(*, context: Context | None = None, uninstall_handlers: bool | None = None) -> None:
    (get_default_context() if context is None else context).shutdown()


def spin(node: Any, executor: Any = None) -> None:
    from rclpy.executors import SingleThreadedExecutor

    executor = SingleThreadedExecutor(context=node.context) if executor is None else executor
    try:
        executor.add_node(node)
        while executor.context.ok():
            executor.spin_once()
    finally:
        executor.remove_node(node)
