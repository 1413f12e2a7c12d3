"""Parameters that describe the node: ``ros2 param get NODE topics``."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from rcl_interfaces.msg import ParameterDescriptor, SetParametersResult
from rclpy.parameter import Parameter

from rosplc._version import __version__

_WORDS = "read-only; set by rosplc"


class Shown:
    """The fixed parameter ``version``, and parameters that change only with the configuration.

    In rclpy, not even the node itself can change a read-only parameter; therefore a callback protects these.
    """

    def __init__(self, node: Any) -> None:
        self._node = node
        self._names: set[str] = set()
        self._ours = False
        if not node.has_parameter("version"):
            version = ParameterDescriptor(read_only=True, description=_WORDS)
            node.declare_parameter("version", __version__, version, True)
        node.add_on_set_parameters_callback(self._judge)

    def update(self, values: Mapping[str, str | list[str]]) -> None:
        """Declare or change parameters; an empty list is shown as ``none``."""
        self._ours = True
        try:
            for name, value in values.items():
                self._put(name, value or "none")
        finally:
            self._ours = False

    def _put(self, name: str, value: str | list[str]) -> None:
        self._names.add(name)
        if self._node.has_parameter(name):
            self._node.set_parameters([Parameter(name, value=value)])
        else:
            descriptor = ParameterDescriptor(description=_WORDS, dynamic_typing=True)
            self._node.declare_parameter(name, value, descriptor, True)

    def _judge(self, parameters: list[Any]) -> Any:
        if self._ours or not any(parameter.name in self._names for parameter in parameters):
            return SetParametersResult(successful=True)
        return SetParametersResult(successful=False, reason=f"it is {_WORDS}")
