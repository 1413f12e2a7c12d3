"""ROS 1 over Debian's ``rospy``; importing this raises ImportError where that is not installed."""

from __future__ import annotations

from rosplc.ros.rospy.backend import RospyBackend, open_backend
from rosplc.ros.rospy.wire import WireDefinition, definition_on_wire, save_definition

__all__ = ["RospyBackend", "WireDefinition", "definition_on_wire", "open_backend", "save_definition"]
