"""ROS 1 over Debian's ``rospy``; importing this raises ImportError where that is not installed."""

from __future__ import annotations

from rosplc.ros.rospy.backend import RospyBackend, open_backend

__all__ = ["RospyBackend", "open_backend"]
