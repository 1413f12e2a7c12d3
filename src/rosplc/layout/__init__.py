"""Where each part of a message lies in its record, and typed access to records."""

from rosplc.layout.compute import MAX_SEQUENCE, MAX_STRING, Limits
from rosplc.layout.layout import Layout, compute_layout
from rosplc.layout.nodes import (
    ArrayNode,
    Member,
    Node,
    PaddingNode,
    ScalarNode,
    SequenceNode,
    StringNode,
    StructNode,
)
from rosplc.layout.view import RecordView, plain

__all__ = [
    "MAX_SEQUENCE",
    "MAX_STRING",
    "ArrayNode",
    "Layout",
    "Limits",
    "Member",
    "Node",
    "PaddingNode",
    "RecordView",
    "ScalarNode",
    "SequenceNode",
    "StringNode",
    "StructNode",
    "compute_layout",
    "plain",
]
