"""ROS messages, services and actions: bundled with a distribution, custom, or from a self-description."""

from rosplc.model.store import DISTROS, TypeStore
from rosplc.model.types import (
    ArrayType,
    FieldType,
    MessageType,
    NamedType,
    PrimitiveType,
    SequenceType,
    StringType,
)

__all__ = [
    "DISTROS", "ArrayType", "FieldType", "MessageType", "NamedType", "PrimitiveType", "SequenceType",
    "StringType", "TypeStore",
]  # fmt: skip
