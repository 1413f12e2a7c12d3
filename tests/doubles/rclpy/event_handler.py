"""rclpy/event_handler.py, since ROS 2 Iron."""

from __future__ import annotations

from rclpy._distro import HUMBLE

if HUMBLE:
    raise ModuleNotFoundError("No module named 'rclpy.event_handler'", name="rclpy.event_handler")

from rclpy._events import EventHandler, PublisherEventCallbacks, SubscriptionEventCallbacks
from rclpy._handles import UnsupportedEventTypeError

__all__ = [
    "EventHandler",
    "PublisherEventCallbacks",
    "SubscriptionEventCallbacks",
    "UnsupportedEventTypeError",
]
