"""What the configuration may say under ``ros.rclpy``."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from rosplc.errors import BackendError

__all__ = ["Options", "read_options"]


@dataclass(frozen=True, slots=True)
class Options:
    """The backend's own keys.

    Attributes:
        ros_args: ROS arguments for the bridge's node, as after ``--ros-args`` on a command line:
            ``["-r", "cmd_vel:=base/cmd_vel", "--enclave", "/cell1"]``.
        parameters: Name → value of parameters that the node shows, and nobody can set.
    """

    ros_args: tuple[str, ...] = ()
    parameters: Mapping[str, str | list[str]] = field(default_factory=dict)


def read_options(options: Mapping[str, object]) -> Options:
    """Read the keys.

    Raises:
        BackendError: ROS013, a key is unknown or its value is not of its kind.
    """
    for key in options:
        if key not in ("ros_args", "parameters"):
            raise BackendError("ROS013", f"ros.rclpy has no key {key!r}; there are: ros_args, parameters")
    arguments = options.get("ros_args", ())
    if not isinstance(arguments, list | tuple) or not all(isinstance(one, str) for one in arguments):
        raise BackendError("ROS013", f"ros.rclpy.ros_args is {arguments!r}; it is a list of strings")
    parameters = options.get("parameters", {})
    if not isinstance(parameters, Mapping) or not all(map(_is_shown, parameters.values())):
        raise BackendError(
            "ROS013", f"ros.rclpy.parameters is {parameters!r}; it maps names to strings or lists of strings"
        )
    return Options(tuple(one for one in arguments if one != "--ros-args"), dict(parameters))


def _is_shown(value: object) -> bool:
    return isinstance(value, str) or (isinstance(value, list) and all(isinstance(one, str) for one in value))
