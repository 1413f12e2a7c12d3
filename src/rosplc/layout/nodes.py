"""A layout as data: where each part of a record lies.

Offsets are bytes from the start of the enclosing struct, sizes are bytes. The rules are spec/type-mapping.md,
section 3; the numbers of every bundled type are compared with gcc's for x86-64, armhf and arm64. The layout
text, from which the layout id follows, is that of section 5.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import ClassVar, TypeAlias


@dataclass(frozen=True, slots=True)
class ScalarNode:
    """A primitive value of the model's primitive ``kind``."""

    kind: str
    size: int

    @property
    def align(self) -> int:
        """Alignment in bytes: the primitive's size."""
        return self.size


@dataclass(frozen=True, slots=True)
class StringNode:
    """A NUL-terminated string: at most ``capacity`` bytes of text, ``capacity + 1`` in all."""

    capacity: int
    bound: int | None = None
    align: ClassVar[int] = 1

    @property
    def size(self) -> int:
        """Bytes taken, the terminator included."""
        return self.capacity + 1


@dataclass(frozen=True, slots=True)
class PaddingNode:
    """Bytes without meaning; an explicit member, so that no compiler adds its own."""

    size: int
    align: ClassVar[int] = 1


@dataclass(frozen=True, slots=True)
class _Elements:
    """Elements ``stride`` bytes apart: ``capacity`` of them have room."""

    element: ScalarNode | StringNode | StructNode
    capacity: int

    @property
    def stride(self) -> int:
        """Bytes from one element to the next: the element's size."""
        return self.element.size

    @property
    def size(self) -> int:
        """Bytes of all elements."""
        return self.capacity * self.element.size

    @property
    def align(self) -> int:
        """The element's alignment."""
        return self.element.align


class ArrayNode(_Elements):
    """``capacity`` elements, all of them in use."""

    __slots__ = ()


@dataclass(frozen=True, slots=True)
class SequenceNode(_Elements):
    """Up to ``capacity`` elements; a ``uint32`` member of the struct with ``count_of`` has their number."""

    bound: int | None = None


@dataclass(frozen=True, slots=True)
class Member:
    """One member of a struct."""

    # the field's name; for a sequence's count the sequence's name (``count_of`` tells the two
    # apart); empty for padding. Generators choose identifiers for both.
    name: str
    offset: int  # bytes from the start of the enclosing struct
    node: Node  # what is there
    count_of: str | None = None  # for a sequence's count: the name of the sequence member; else None


@dataclass(frozen=True, slots=True)
class StructNode:
    """A message type with its limits applied; ``size`` is a multiple of ``align``.

    A message without fields has one member, a padding byte: a ROS 1 wire has nothing of it, a ROS 2 wire one
    zero byte.
    """

    type_name: str
    members: tuple[Member, ...]
    size: int
    align: int

    @property
    def empty(self) -> bool:
        """Whether the message has no fields."""
        return all(isinstance(member.node, PaddingNode) for member in self.members)


Node: TypeAlias = "ScalarNode | StringNode | PaddingNode | ArrayNode | SequenceNode | StructNode"


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
        counts = member is not None and member.count_of is not None
        what = f"count({capacities[path]})" if counts else _what(node)
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


def _items(
    node: Node, offset: int, path: str, member: Member | None = None
) -> Iterator[tuple[str, int, Node, Member | None]]:
    """Yield everything that has a line, in the text's order; padding's path is empty."""
    if isinstance(node, StructNode):
        for inner in node.members:
            below = f"{path}.{inner.name}" if path else inner.name
            below = "" if isinstance(inner.node, PaddingNode) else below
            yield from _items(inner.node, offset + inner.offset, below, inner)
        return
    yield path, offset, node, member
    if isinstance(node, ArrayNode | SequenceNode):
        yield from _items(node.element, offset, f"{path}[]")


def _what(node: Node) -> str:
    if isinstance(node, ScalarNode):
        return node.kind
    if isinstance(node, StringNode):
        return f"string({node.capacity})"
    if isinstance(node, PaddingNode):
        return f"padding({node.size})"
    if isinstance(node, ArrayNode):
        return f"array({node.capacity},{node.stride})"
    assert isinstance(node, SequenceNode)
    return f"sequence({node.capacity},{node.stride})"


def _by_path(text: str) -> dict[str, str]:
    """Return each path's line, without the offsets that follow from it."""
    lines = text.splitlines()
    found = {"type": lines[1].split(" ", 1)[0]} if len(lines) > 1 else {}
    for line in lines[2:]:
        _, path, what = line.split(" ", 2)
        if path != "-" and not what.startswith("sequence("):
            # An array's stride follows from its element: only the length is news.
            found[path] = what.split(",")[0] + ")" if what.startswith("array(") else what
    return found
