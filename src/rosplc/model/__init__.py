"""ROS message types as data: bundled with a distribution, custom, or from a self-description."""

from rosplc.model.folders import save_definitions, split_definition
from rosplc.model.store import DISTROS, MAX_DEPTH, TypeStore
from rosplc.model.types import (
    PRIMITIVES,
    ArrayType,
    Constant,
    Field,
    FieldType,
    MessageType,
    NamedType,
    PrimitiveType,
    SequenceType,
    StringType,
    Value,
)

__all__ = [
    "DISTROS",
    "MAX_DEPTH",
    "PRIMITIVES",
    "ArrayType",
    "Constant",
    "Field",
    "FieldType",
    "MessageType",
    "NamedType",
    "PrimitiveType",
    "SequenceType",
    "StringType",
    "TypeStore",
    "Value",
    "save_definitions",
    "split_definition",
]
