"""ROS 2 through an installed ROS 2: whatever middleware, security and machine that one has."""

from rosplc.ros.rclpy.backend import RclpyBackend, from_node, open_backend

__all__ = ["RclpyBackend", "from_node", "open_backend"]
