"""ROS 2 over Zenoh as ``rmw_zenoh_cpp`` speaks it, through the ``eclipse-zenoh`` wheel alone."""

from rosplc.ros.zenoh.backend import ZenohBackend, open_backend

__all__ = ["ZenohBackend", "open_backend"]
