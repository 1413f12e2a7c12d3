"""Message classes of rospy, rclpy and rosbags: their type's name, and objects from bytes."""

from __future__ import annotations

import importlib
from typing import Any

from rosplc.errors import MessageTypeError

__all__ = ["definition_of", "deserialize", "type_name_of"]


def definition_of(message_class: type | None) -> str | None:
    """Return the definition that a class of rospy carries, None for all others."""
    text = getattr(message_class, "_full_text", None)
    return text if isinstance(text, str) else None


def type_name_of(message_class: type) -> str:
    """Return the type name of a message class of rospy, rosbags or rclpy.

    Raises:
        MessageTypeError: TYP001, it is no message class.
    """
    for attribute in ("_type", "__msgtype__"):
        if isinstance(name := getattr(message_class, attribute, None), str):
            return name
    package, *rest = message_class.__module__.split(".")
    if not rest or rest[0] != "msg":
        raise MessageTypeError(
            "TYP001",
            f"{message_class.__name__} is no message class",
            remedy="Give the class of rclpy or rospy, or the type's name.",
        )
    return f"{package}/msg/{message_class.__name__}"


def deserialize(message_class: type, data: bytes) -> Any:
    """Return an object of a class of rospy or rclpy."""
    if hasattr(message_class, "deserialize"):  # rospy
        return message_class().deserialize(data)
    return importlib.import_module("rclpy.serialization").deserialize_message(data, message_class)
