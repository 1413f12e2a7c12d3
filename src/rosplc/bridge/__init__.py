"""A configuration file becomes a running bridge between ROS and the channels."""

from __future__ import annotations

__all__: list[str] = []
