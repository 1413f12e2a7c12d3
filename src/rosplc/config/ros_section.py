"""What contradicts itself in a configuration's section ``ros``."""

from __future__ import annotations

from rosplc.config.file import Config
from rosplc.config.problems import Problems
from rosplc.errors import ConfigError
from rosplc.ros import ROS1

__all__ = ["OWN_SETTINGS", "check_ros"]

# Backends with a section of their own.
OWN_SETTINGS = ("zenoh", "rclpy")
_ROS2 = ("dds", "rclpy", "zenoh")


def check_ros(config: Config, problems: Problems) -> None:
    """Note what contradicts itself in the section ``ros``."""
    ros, source = config.settings.ros, config.source

    def refuse(key: tuple[str, ...], what: str, remedy: str = "", code: str = "CFG004") -> None:
        error = ConfigError(code, what, where=source.place(key), remedy=remedy)
        problems.add(error, source.line(key))

    if ros.backend in _ROS2 and ros.distro == ROS1:
        what = f"the {ros.backend} backend speaks ROS 2, and {ROS1} is ROS 1"
        refuse(("ros", "backend"), what, "Write `backend: rospy` (or auto), or a distro of ROS 2.")
    if ros.backend == "rospy" and ros.distro != ROS1:
        known = "" if "distro" in ros.model_fields_set else " (the default)"
        what = f"the rospy backend speaks ROS 1, and {ros.distro}{known} is ROS 2"
        refuse(("ros", "backend"), what, f"Write `distro: {ROS1}`, or `backend: auto`.")
    for name in OWN_SETTINGS:
        if getattr(ros, name) is None:
            continue
        if ros.backend not in ("auto", name):
            what = f"settings of the {name} backend, while the backend is {ros.backend}"
            refuse(("ros", name), what, f"Write `backend: {name}`, or remove them.")
        elif ros.distro == ROS1:
            what = f"settings of the {name} backend, which speaks ROS 2; {ROS1} is ROS 1"
            refuse(("ros", name), what, "Remove them, or choose a distro of ROS 2.")
    if ros.zenoh is not None and ros.zenoh.config is not None:
        path = config.base / ros.zenoh.config
        if not path.is_file():
            refuse(("ros", "zenoh", "config"), f"{path} is no file", "Correct the path.", "CFG001")
