"""A layout as data, and how it follows from a type and limits: where each part of a record lies.

Offsets are bytes from the start of the enclosing struct, sizes are bytes. The rules are spec/type-mapping.md,
section 3; the numbers of every bundled type are compared with gcc's for x86-64, armhf and arm64. The layout
text, from which the layout id follows, is that of section 5.
"""

from __future__ import annotations

import dataclasses
import difflib
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any, ClassVar, TypeAlias

from rosplc.errors import LayoutError
from rosplc.model import ArrayType, FieldType, NamedType, PrimitiveType, SequenceType, StringType, TypeStore
from rosplc.model.parse import check_names
from rosplc.model.types import PRIMITIVES, Field


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


def walk(node: Node) -> Iterator[tuple[str, int, Node]]:
    """Yield path, offset and node of everything below a struct that has bytes of its own.

    Arrays and sequences come before their element (the first one's offset). Structs
    themselves, padding and counts are left out.
    """
    for item_path, item_offset, item, member in _items(node, 0, ""):
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
            found.append(f"{path} exists only on this side")
        elif path not in mine:
            found.append(f"{path} exists only on the other side")
        elif mine[path] != theirs[path]:
            found.append(f"{path} is {mine[path]} on this side, {theirs[path]} on the other")
    if not found:
        found.append("the fields are in a different order")
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


MAX_STRING = 65534  # Largest capacity of a string in bytes.
MAX_SEQUENCE = 1 << 24  # Largest capacity of a sequence in elements.


@dataclasses.dataclass(frozen=True)
class Limits:
    """Capacities of one topic's strings and sequences (spec/type-mapping.md, section 2).

    Attributes:
        string: Bytes of each string that is not listed in ``fields``.
        sequence: Elements of each sequence that is not listed in ``fields``.
        fields: Capacity by field path, such as ``{"name": 6, "name[]": 20}``.

    Raises:
        LayoutError: LAY001 if a capacity is not a whole number or is out of range.
    """

    string: int = 80
    sequence: int = 16
    fields: Mapping[str, int] = dataclasses.field(default_factory=dict)

    def __post_init__(self) -> None:
        _check(self.string, MAX_STRING, "string")
        _check(self.sequence, MAX_SEQUENCE, "sequence")
        for path, capacity in self.fields.items():
            _check(capacity, MAX_SEQUENCE, path)
        object.__setattr__(self, "fields", dict(sorted(self.fields.items())))

    def __hash__(self) -> int:
        return hash((self.string, self.sequence, tuple(self.fields.items())))

    def to_dict(self) -> dict[str, Any]:
        """Return the limits as plain data, as in a self-description."""
        return {"string": self.string, "sequence": self.sequence, "fields": dict(self.fields)}

    @classmethod
    def from_dict(cls, data: Mapping[str, Any]) -> Limits:
        """Return the limits from the output of :meth:`to_dict`, which is not trusted.

        Raises LayoutError: LAY001 if the data has another form or a capacity is not valid.
        """
        fields = data.get("fields", {})
        unknown = set(data) - {"string", "sequence", "fields"}
        if unknown or not isinstance(fields, dict) or not all(isinstance(path, str) for path in fields):
            raise LayoutError("LAY001", "limits do not have the form {string, sequence, fields}")
        return cls(data.get("string", 80), data.get("sequence", 16), fields)


def _check(capacity: object, largest: int, where: str) -> None:
    # bool is an int to Python, and `yes` in a configuration is a mistake, not a 1.
    if not isinstance(capacity, int) or isinstance(capacity, bool) or not 1 <= capacity <= largest:
        raise LayoutError("LAY001", f"capacity {capacity!r} is not between 1 and {largest}", where=where)


MAX_RECORD = 1 << 30  # Largest record in bytes.
MAX_ITEMS = 1 << 16  # Most lines of a layout text: a definition of 32 levels could name billions of fields.

_COUNT = ScalarNode("uint32", 4)


def compute_struct(store: TypeStore, type_name: str, limits: Limits) -> StructNode:
    """Return where everything lies in a record. Raises as ``compute_layout``; TYP002 for a bad field name."""
    return _Builder(store, type_name, limits).struct(store[type_name].name, dict(limits.fields), "")[0]


class _Builder:
    """Builds structs bottom-up; equal types with equal limits share one node."""

    def __init__(self, store: TypeStore, type_name: str, limits: Limits) -> None:
        self._store = store
        self._type_name = type_name
        self._limits = limits
        self._known: dict[tuple[str, tuple[tuple[str, int], ...]], tuple[StructNode, int]] = {}

    def struct(self, type_name: str, limits: dict[str, int], path: str) -> tuple[StructNode, int]:
        """Return the node and its number of layout lines.

        The paths of ``limits`` are relative to this struct, whose own ``path``, for errors, ends with a dot.
        """
        key = (type_name, tuple(sorted(limits.items())))
        if key not in self._known:
            self._known[key] = self._build(type_name, dict(limits), path)
        return self._known[key]

    def _build(self, type_name: str, limits: dict[str, int], path: str) -> tuple[StructNode, int]:
        members: list[Member] = []
        offset, align, items = 0, 1, 0

        def place(name: str, node: Node, count_of: str | None = None) -> None:
            nonlocal offset, align
            if gap := -offset % node.align:
                members.append(Member("", offset, PaddingNode(gap)))
            members.append(Member(name, offset + gap, node, count_of))
            offset += gap + node.size
            align = max(align, node.align)

        message = self._store[type_name]
        check_names(message)
        for field in message.fields:
            node, lines = self._node(field, field.type, _take(limits, field.name), f"{path}{field.name}")
            if isinstance(node, SequenceNode):
                place(field.name, _COUNT, count_of=field.name)
                lines += 1
            place(field.name, node)
            items += lines
            if offset > MAX_RECORD or items > MAX_ITEMS:
                what = f"{MAX_RECORD} bytes" if offset > MAX_RECORD else f"{MAX_ITEMS} fields"
                raise LayoutError(
                    "LAY003", f"the record exceeds the limit of {what} at this field", where=path + field.name
                )
        self._none_left(limits, path)
        if not members:
            members.append(Member("", 0, PaddingNode(1)))
            offset = items = 1
        if gap := -offset % align:
            members.append(Member("", offset, PaddingNode(gap)))
            offset += gap
        return StructNode(type_name, tuple(members), offset, align), items

    def _node(self, field: Field, kind: FieldType, limits: dict[str, int], path: str) -> tuple[Node, int]:
        """Return a field's node; ``limits`` are relative to the field, its own under ``""``."""
        if isinstance(kind, PrimitiveType):
            self._none_left(limits, path)
            return ScalarNode(kind.name, PRIMITIVES[kind.name]), 1
        if isinstance(kind, StringType):
            capacity = self._capacity(limits.pop("", None), kind.bound, self._limits.string, MAX_STRING, path)
            self._none_left(limits, path)
            values = field.default if isinstance(field.default, tuple) else (field.default,)
            texts = (value.encode("utf-8", "surrogateescape") for value in values if isinstance(value, str))
            _default_fits(max(map(len, texts), default=0), capacity, path)
            return StringNode(capacity, kind.bound), 1
        if isinstance(kind, NamedType):
            inner = _strip(limits, ".")
            self._none_left(limits, path)
            return self.struct(kind.name, inner, f"{path}.")
        own = limits.pop("", None)
        below = _strip(limits, "[]")
        self._none_left(limits, path)
        capacity = 0
        if isinstance(kind, SequenceType):
            capacity = self._capacity(own, kind.bound, self._limits.sequence, MAX_SEQUENCE, path)
            _default_fits(len(field.default) if isinstance(field.default, tuple) else 0, capacity, path)
        elif own is not None:
            raise self._unknown_limit(path)
        element, lines = self._node(field, kind.element, below, f"{path}[]")
        assert isinstance(element, ScalarNode | StringNode | StructNode)
        if isinstance(kind, ArrayType):
            return ArrayNode(element, kind.length), lines + 1
        return SequenceNode(element, capacity, kind.bound), lines + 1

    def _capacity(self, own: int | None, bound: int | None, default: int, largest: int, path: str) -> int:
        if own is not None and bound is not None and own > bound:
            raise LayoutError("LAY004", f"capacity {own} exceeds the definition's bound, {bound}", where=path)
        capacity = own if own is not None else default if bound is None else min(default, bound)
        if capacity > largest:
            raise LayoutError("LAY001", f"capacity {capacity} is not between 1 and {largest}", where=path)
        return capacity

    def _none_left(self, limits: dict[str, int], path: str) -> None:
        if limits:
            raise self._unknown_limit(path + next(iter(limits)))

    def _unknown_limit(self, path: str) -> LayoutError:
        known = limit_paths(self._store, self._type_name)
        near = difflib.get_close_matches(path, known, 1, 0.5)
        hint = f"; did you mean {near[0]}?" if near else ""
        return LayoutError(
            "LAY002", f"{self._type_name} has no string or sequence at this path{hint}", where=path
        )


def limit_paths(store: TypeStore, type_name: str) -> list[str]:
    """Return the paths of a type's strings and sequences, as far as a few thousand fields show."""
    found: list[str] = []
    budget = 4096

    def visit(name: str, path: str) -> None:
        nonlocal budget
        for field in store[name].fields:
            budget -= 1
            if budget < 0:
                return
            kind, here = field.type, path + field.name
            if isinstance(kind, SequenceType):
                found.append(here)
            if isinstance(kind, ArrayType | SequenceType):
                kind, here = kind.element, f"{here}[]"
            if isinstance(kind, StringType):
                found.append(here)
            elif isinstance(kind, NamedType):
                visit(kind.name, f"{here}.")

    visit(type_name, "")
    return found


def _take(limits: dict[str, int], name: str) -> dict[str, int]:
    """Remove what concerns field ``name`` from ``limits``; return it relative to the field."""
    mine = [path for path in limits if path == name or path.startswith((f"{name}.", f"{name}[]"))]
    return {path[len(name) :]: limits.pop(path) for path in mine}


def _strip(limits: dict[str, int], prefix: str) -> dict[str, int]:
    """Remove the paths with ``prefix`` from ``limits``; return them without it."""
    mine = [path for path in limits if path.startswith(prefix)]
    return {path[len(prefix) :]: limits.pop(path) for path in mine}


def _default_fits(size: int, capacity: int, path: str) -> None:
    if size > capacity:
        raise LayoutError(
            "LAY006",
            f"the definition's default value needs a capacity of {size}, but the limit is {capacity}",
            where=path,
            remedy="Raise the limit of this field.",
        )
