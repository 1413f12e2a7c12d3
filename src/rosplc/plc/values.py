"""A message's fields as the initial value of a structure: ``(linear := (x := 0.5))``."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from rosplc.layout import Layout
from rosplc.layout.nodes import ArrayNode, Node, ScalarNode, SequenceNode, StringNode, StructNode
from rosplc.plc.literals import literal
from rosplc.plc.types import DutBuilder

__all__ = ["initial_value"]


def initial_value(layout: Layout, value: Mapping[str, Any], builder: DutBuilder) -> str | None:
    """Return the initial value that gives a message these fields, and all others their own initial value.

    Args:
        layout: The message's layout.
        value: Fields as :meth:`Layout.pack` takes them from a mapping; it has accepted them.
        builder: Knows the identifiers.

    Returns:
        The text; None if ``value`` names no field.
    """
    return _struct(layout.root, value, builder)


def _struct(node: StructNode, value: Mapping[str, Any], builder: DutBuilder) -> str | None:
    names = builder.struct(node)
    parts = []
    for member in node.members:
        if not member.name or member.name not in value:
            continue
        given = value[member.name]
        text = str(len(given)) if member.count_of else _value(member.node, given, builder)
        if text is not None:
            parts.append(f"{names.of(node, member)} := {text}")
    return f"({', '.join(parts)})" if parts else None


def _value(node: Node, value: Any, builder: DutBuilder) -> str | None:
    if isinstance(node, StructNode):
        return _struct(node, value, builder)
    if isinstance(node, ScalarNode):
        return literal(node.kind, value)
    if isinstance(node, StringNode):
        return literal("string", value)
    assert isinstance(node, (ArrayNode, SequenceNode))
    return _elements(node, value, builder)


def _elements(node: ArrayNode | SequenceNode, value: Any, builder: DutBuilder) -> str | None:
    """Return an array's initial value; elements beyond those given are as if nobody had filled them."""
    element = node.element
    if isinstance(element, StructNode):
        # An element without a field of its own still needs a place: it names one that is initial.
        texts = [_struct(element, item, builder) or _untouched(element, builder) for item in value]
        return None if None in texts or not texts else f"[{', '.join(str(text) for text in texts)}]"
    kind = element.kind if isinstance(element, ScalarNode) else "string"
    texts = [literal(kind, item) for item in value]
    capacity = node.length if isinstance(node, ArrayNode) else node.capacity
    if capacity > len(texts):
        # Written out: a default value of the definition, which may be longer, must not show through.
        texts.append(f"{capacity - len(texts)}({literal(kind, '' if kind == 'string' else 0)})")
    return f"[{', '.join(str(text) for text in texts)}]"


def _untouched(node: StructNode, builder: DutBuilder) -> str | None:
    """Return a structure's initial value, written with one of its members; None if it has none at all."""
    defaults = {item.name: item.default for item in builder.store[node.type_name].fields}
    names = builder.struct(node)
    for member in node.members:
        default = defaults.get(member.count_of or member.name)
        text = _plain(member.node, default, builder) if member.name else None
        if text is not None:
            return f"({names.of(node, member)} := {text})"
    return None


def _plain(node: Node, default: Any, builder: DutBuilder) -> str | None:
    """Return a member's initial value; None where it has a default that is a list."""
    if isinstance(node, StructNode):
        return _untouched(node, builder)
    if isinstance(default, tuple):
        return None
    if isinstance(node, ScalarNode):
        return literal(node.kind, 0 if default is None else default)
    if isinstance(node, StringNode):
        return literal("string", default or "")
    if isinstance(node, (ArrayNode, SequenceNode)):
        inner = _plain(node.element, None, builder)
        return None if inner is None else f"[{inner}]"
    return None
