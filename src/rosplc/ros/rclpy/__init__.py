"""ROS 2 through a ROS 2 installation, with its middleware and security, on any machine."""

from rosplc.ros.rclpy.backend import RclpyBackend, from_node, open_backend

__all__ = ["RclpyBackend", "from_node", "open_backend"]
