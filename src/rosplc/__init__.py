"""rosplc: the bridge between ROS and IEC 61131-3 soft-PLCs over POSIX shared memory."""

from __future__ import annotations

from rosplc._version import __version__

__all__ = ["__version__"]
