"""rclpy/lifecycle/__init__.py."""

from __future__ import annotations

from rclpy.lifecycle.node import LifecycleNode, LifecycleNodeMixin, LifecycleState, TransitionCallbackReturn

__all__ = ["LifecycleNode", "LifecycleNodeMixin", "LifecycleState", "TransitionCallbackReturn"]
