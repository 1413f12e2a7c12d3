"""ROS 2 over DDS without a ROS installation: the ``cyclonedds`` wheel."""

from rosplc.ros.dds.backend import DdsBackend, open_backend

__all__ = ["DdsBackend", "open_backend"]
