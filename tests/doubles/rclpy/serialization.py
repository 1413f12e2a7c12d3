"""rclpy/serialization.py: an object of the double keeps the bytes that it was made of."""

from __future__ import annotations

from typing import Any

from rclpy._handles import RCLError


def serialize_message(message: Any) -> bytes:
    return bytes(message._double_bytes)


def deserialize_message(serialized_message: bytes, message_type: Any) -> Any:
    if len(serialized_message) < 4:
        raise RCLError("failed to deserialize ROS message: test")
    message = message_type()
    message._double_bytes = serialized_message
    return message
