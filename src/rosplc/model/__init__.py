"""ROS messages, services and actions: bundled with a distribution, custom, or from a self-description."""

from rosplc.model.folders import save_definitions, split_definition
from rosplc.model.store import DISTROS, MAX_DEPTH, TypeStore
from rosplc.model.types import (
    PRIMITIVES,
    ActionType,
    ArrayType,
    Constant,
    Field,
    FieldType,
    MessageType,
    NamedType,
    PrimitiveType,
    SequenceType,
    ServiceType,
    StringType,
    Value,
)

__all__ = [
    "DISTROS",
    "MAX_DEPTH",
    "PRIMITIVES",
    "ActionType",
    "ArrayType",
    "Constant",
    "Field",
    "FieldType",
    "MessageType",
    "NamedType",
    "PrimitiveType",
    "SequenceType",
    "ServiceType",
    "StringType",
    "TypeStore",
    "Value",
    "save_definitions",
    "split_definition",
]
