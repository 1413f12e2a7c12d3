"""``ros2 run rosplc_bridge bridge``: the lifecycle node, served until a signal or shutdown."""

from __future__ import annotations

import logging
import sys

import rclpy
from rclpy.executors import ExternalShutdownException

from rosplc_bridge.lifecycle_node import BridgeNode

__all__ = ["main"]


def main() -> int:
    """Serve the node; signals are rclpy's business here, since the process is the node's own."""
    logging.basicConfig(level=logging.INFO, format="[%(levelname)s] [%(name)s]: %(message)s")
    rclpy.init(args=sys.argv)
    node = BridgeNode()
    try:
        rclpy.spin(node)
    except (KeyboardInterrupt, ExternalShutdownException):
        pass
    finally:
        node.destroy_node()
        rclpy.try_shutdown()
    return 0
