"""The layout text, from which the layout id follows (spec/type-mapping.md, section 5)."""

from __future__ import annotations

from typing import TYPE_CHECKING

from rosplc.layout.nodes import ArrayNode, PaddingNode, ScalarNode, SequenceNode, StringNode, StructNode

if TYPE_CHECKING:
    from collections.abc import Iterator

    from rosplc.layout.nodes import Member, Node


def walk(node: Node, offset: int = 0, path: str = "") -> Iterator[tuple[str, int, Node]]:
    """Yield path, offset and node of everything below a struct that has bytes of its own.

    Arrays and sequences come before their element (the first one's offset). Structs
    themselves, padding and counts are left out.
    """
    for item_path, item_offset, item, member in _items(node, offset, path):
        if not isinstance(item, PaddingNode) and (member is None or member.count_of is None):
            yield item_path, item_offset, item


def layout_text(root: StructNode) -> str:
    """Return the layout text of a record."""
    lines = ["rosplc-layout 1", f"{root.type_name} size {root.size} align {root.align}"]
    capacities: dict[str, int] = {
        path: node.capacity for path, _, node in walk(root) if isinstance(node, SequenceNode)
    }
    for path, offset, node, member in _items(root, 0, ""):
        if member is not None and member.count_of is not None:
            what = f"count({capacities[path]})"
        else:
            what = _what(node)
        lines.append(f"{offset} {path or '-'} {what}")
    return "".join(f"{line}\n" for line in lines)


def layout_difference(one: str, other: str, limit: int = 5) -> str:
    """Say how this side's layout text differs from the other's, in up to ``limit`` fields; empty if equal."""
    if one == other:
        return ""
    mine, theirs = _by_path(one), _by_path(other)
    found: list[str] = []
    for path in dict.fromkeys((*mine, *theirs)):
        if path not in theirs:
            found.append(f"{path} is here only")
        elif path not in mine:
            found.append(f"{path} is there only")
        elif mine[path] != theirs[path]:
            found.append(f"{path} is {mine[path]} here and {theirs[path]} there")
    if not found:
        found.append("the fields stand in another order")
    more = f", and {len(found) - limit} more" if len(found) > limit else ""
    return "; ".join(found[:limit]) + more


def _items(node: Node, offset: int, path: str) -> Iterator[tuple[str, int, Node, Member | None]]:
    """Yield everything that has a line, in the text's order; padding's path is empty."""
    if isinstance(node, StructNode):
        for member in node.members:
            start = offset + member.offset
            if isinstance(member.node, PaddingNode):
                yield "", start, member.node, member
            else:
                below = f"{path}.{member.name}" if path else member.name
                if isinstance(member.node, StructNode):
                    yield from _items(member.node, start, below)
                else:
                    yield below, start, member.node, member
                    yield from _elements(member.node, start, below)


def _elements(node: Node, offset: int, path: str) -> Iterator[tuple[str, int, Node, Member | None]]:
    if isinstance(node, ArrayNode | SequenceNode):
        below = f"{path}[]"
        if isinstance(node.element, StructNode):
            yield from _items(node.element, offset, below)
        else:
            yield below, offset, node.element, None


def _what(node: Node) -> str:
    if isinstance(node, ScalarNode):
        return node.kind
    if isinstance(node, StringNode):
        return f"string({node.capacity})"
    if isinstance(node, PaddingNode):
        return f"padding({node.size})"
    if isinstance(node, ArrayNode):
        return f"array({node.length},{node.stride})"
    assert isinstance(node, SequenceNode)
    return f"sequence({node.capacity},{node.stride})"


def _by_path(text: str) -> dict[str, str]:
    """Return what stands at each path, without the offsets that follow from it."""
    lines = text.splitlines()
    found = {"type": lines[1].split(" ", 1)[0]} if len(lines) > 1 else {}
    for line in lines[2:]:
        _, path, what = line.split(" ", 2)
        if path != "-" and not what.startswith("sequence("):
            # An array's stride follows from its element: only the length is news.
            found[path] = what.split(",")[0] + ")" if what.startswith("array(") else what
    return found
