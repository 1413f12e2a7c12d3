"""Which structs look the same on the wire and in the record, so that many are copied in one piece."""

from __future__ import annotations

from dataclasses import dataclass

from rosplc.layout.nodes import ArrayNode, Node, ScalarNode, StructNode


@dataclass(frozen=True, slots=True)
class Flat:
    """A struct or number without gaps, whose wire bytes are its record bytes.

    Attributes:
        first: Alignment of its first number in bytes: where CDR starts it.
        widest: Alignment that the whole needs to be free of gaps, in bytes.
        uniform: All numbers have the same width (then swapping needs no structure).
    """

    first: int
    widest: int
    uniform: bool


def flat_form(node: Node) -> Flat | None:
    """Return how ``node`` is flat, or None if anything but numbers is in it.

    Bools are not flat: their values are checked. Neither are structs with padding, since CDR
    has none at a struct's end.
    """
    if isinstance(node, ScalarNode):
        return None if node.kind == "bool" else Flat(node.size, node.size, True)
    if isinstance(node, ArrayNode):
        return flat_form(node.element) if node.length else None
    if not isinstance(node, StructNode) or not node.members:
        return None
    parts = [flat_form(member.node) for member in node.members]
    known = [part for part in parts if part is not None]
    if len(known) != len(parts) or any(member.count_of for member in node.members):
        return None
    widest = max(part.widest for part in known)
    uniform = all(part.uniform and part.widest == widest for part in known)
    return Flat(known[0].first, widest, uniform)
