"""Type and limits (how much room strings and sequences get) → struct nodes: spec/type-mapping.md, 2 and 3."""

from __future__ import annotations

import dataclasses
import difflib
from collections.abc import Mapping
from typing import Any

from rosplc.errors import LayoutError
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
from rosplc.model import ArrayType, FieldType, NamedType, PrimitiveType, SequenceType, StringType, TypeStore
from rosplc.model.parse import check_names
from rosplc.model.types import PRIMITIVES, Field

MAX_STRING = 65534  # Largest capacity of a string in bytes.
MAX_SEQUENCE = 1 << 24  # Largest capacity of a sequence in elements.


@dataclasses.dataclass(frozen=True)
class Limits:
    """Capacities of one topic's strings and sequences (spec/type-mapping.md, section 2).

    Attributes:
        string: Bytes of every string that ``fields`` does not name.
        sequence: Elements of every sequence that ``fields`` does not name.
        fields: Capacity by field path, such as ``{"name": 6, "name[]": 20}``.

    Raises:
        LayoutError: LAY001, a capacity is no whole number or out of range.
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
        """Return plain data, as a self-description stores it."""
        return {"string": self.string, "sequence": self.sequence, "fields": dict(self.fields)}

    @classmethod
    def from_dict(cls, data: Mapping[str, Any]) -> Limits:
        """Return the limits that :meth:`to_dict` wrote; the data is not trusted.

        Raises LayoutError: LAY001, the data has another form or a capacity is not valid.
        """
        fields = data.get("fields", {})
        unknown = set(data) - {"string", "sequence", "fields"}
        if unknown or not isinstance(fields, dict) or not all(isinstance(path, str) for path in fields):
            raise LayoutError("LAY001", "limits are not of the form {string, sequence, fields}")
        return cls(data.get("string", 80), data.get("sequence", 16), fields)


def _check(capacity: object, largest: int, where: str) -> None:
    # bool is an int to Python, and `yes` in a configuration is a mistake, not a 1.
    if not isinstance(capacity, int) or isinstance(capacity, bool) or not 1 <= capacity <= largest:
        raise LayoutError("LAY001", f"capacity {capacity!r} is not within 1 … {largest}", where=where)


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
                what = f"{offset} bytes" if offset > MAX_RECORD else f"more than {MAX_ITEMS} fields"
                raise LayoutError(
                    "LAY003", f"{what} so far, more than a record can have", where=path + field.name
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
            raise LayoutError("LAY004", f"capacity {own} exceeds the bound {bound}", where=path)
        capacity = own if own is not None else default if bound is None else min(default, bound)
        if capacity > largest:
            raise LayoutError("LAY001", f"capacity {capacity} is not within 1 … {largest}", where=path)
        return capacity

    def _none_left(self, limits: dict[str, int], path: str) -> None:
        if limits:
            raise self._unknown_limit(path + next(iter(limits)))

    def _unknown_limit(self, path: str) -> LayoutError:
        known = limit_paths(self._store, self._type_name)
        near = difflib.get_close_matches(path, known, 1, 0.5)
        hint = f"; did you mean {near[0]}?" if near else ""
        return LayoutError(
            "LAY002", f"no string or sequence of {self._type_name} has this path{hint}", where=path
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
            f"the definition's default value needs a capacity of {size}, the limit is {capacity}",
            where=path,
            remedy="Raise the limit of this field.",
        )
