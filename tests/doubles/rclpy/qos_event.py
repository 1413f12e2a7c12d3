"""rclpy/qos_event.py, up to ROS 2 Humble (later a deprecated name, which the backend must not use)."""

from __future__ import annotations

from rclpy._distro import HUMBLE

if not HUMBLE:
    raise ModuleNotFoundError("rclpy.qos_event is deprecated; use rclpy.event_handler")

from rclpy._events import PublisherEventCallbacks, SubscriptionEventCallbacks
from rclpy._handles import UnsupportedEventTypeError

__all__ = ["PublisherEventCallbacks", "SubscriptionEventCallbacks", "UnsupportedEventTypeError"]
