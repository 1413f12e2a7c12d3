"""Parameters by which a node shows what it is: ``ros2 param get NODE topics``."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from rcl_interfaces.msg import ParameterDescriptor

from rosplc._version import __version__

__all__ = ["show"]


def show(node: Any, values: Mapping[str, str | list[str]]) -> None:
    """Declare read-only parameters; ``version`` always, and those given.

    Args:
        node: An ``rclpy.node.Node``.
        values: Name → value. An override from outside (``-p name:=value``) does not change it, and
            an empty list is left out: rclpy cannot tell its type.
    """
    for name, value in {"version": __version__, **values}.items():
        if value != [] and not node.has_parameter(name):
            descriptor = ParameterDescriptor(read_only=True, description="shown only; set by rosplc")
            node.declare_parameter(name, value, descriptor, True)
