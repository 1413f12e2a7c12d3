"""ROS 2 over Zenoh, compatible with ``rmw_zenoh_cpp``, with only the ``eclipse-zenoh`` wheel."""

from rosplc.ros.zenoh.backend import ZenohBackend, open_backend

__all__ = ["ZenohBackend", "open_backend"]
