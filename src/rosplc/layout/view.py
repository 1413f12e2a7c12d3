"""Records and values: what the C core makes of a layout, once, and the views that it returns."""

from __future__ import annotations

import keyword
from collections.abc import Iterable
from typing import Any, ClassVar, NoReturn

from rosplc._core import Shape, View
from rosplc.layout import nodes
from rosplc.model import TypeStore

_SHOWN = 8
# genpy's own classes name the two words of a time differently, and count nsecs signed.
_GENPY = {"sec": "secs", "nanosec": "nsecs"}
_TIMES = ("builtin_interfaces/msg/Time", "builtin_interfaces/msg/Duration")


class Excerpt(list[Any]):
    """The first elements of an array that is longer."""

    def __init__(self, elements: Iterable[Any], length: int) -> None:
        super().__init__(elements)
        self.length = length  # how many elements the array has


class RecordView(View):
    """A message in a record: its fields are attributes, read from the bytes at each access.

    A view does not copy: if the buffer changes, so do the values (``copy.deepcopy`` returns an
    independent view). Nested messages are views, arrays and sequences are lists of values or
    views, and strings are ``str``. Bytes that are not UTF-8 become surrogates
    (``surrogateescape``); packing restores the original bytes. A count above a sequence's
    capacity is read as the capacity, and a string ends at its NUL or at its capacity. Two views
    are equal if all their fields are equal.
    """

    __slots__ = ()

    _type_name: ClassVar[str]  # both by a subclass for each struct, whose other attributes are the fields
    _names: ClassVar[tuple[str, ...]]

    def __setattr__(self, name: str, value: object) -> NoReturn:
        raise AttributeError("record views are read-only; to change values, pack a new record")

    def __dir__(self) -> list[str]:
        return [name for name in vars(type(self)) if not name.startswith("_")]

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, RecordView):
            return NotImplemented
        return (
            self._type_name == other._type_name
            and set(self._names) == set(other._names)
            and all(getattr(self, name) == getattr(other, name) for name in self._names)
        )

    __hash__ = None  # type: ignore[assignment]

    def __repr__(self) -> str:
        short = self._type_name.rsplit("/", 1)[1]
        return f"{short}({', '.join(f'{name}={_show(getattr(self, name))}' for name in self._names)})"


def plain(view: RecordView) -> dict[str, Any]:
    """Return a view as dicts and lists."""
    return view._to_dict()


def _show(value: Any) -> str:
    if isinstance(value, list) and len(value) > _SHOWN:
        shown = ", ".join(repr(item) for item in value[:_SHOWN])
        return f"[{shown}, … {len(value) - _SHOWN} more]"
    return repr(value)


def shape_of(root: nodes.StructNode, store: TypeStore) -> Shape:
    """Return what packs and reads the records of a struct. Raises LayoutError LAY006: a bad default value."""
    known: dict[int, Shape] = {}

    def struct(node: nodes.StructNode) -> Shape:
        if (found := known.get(id(node))) is not None:
            return found
        counts = {member.count_of: member.offset for member in node.members if member.count_of is not None}
        fields: list[tuple[object, ...]] = []
        for member in node.members:
            if isinstance(member.node, nodes.PaddingNode) or member.count_of is not None:
                continue
            name, number, element = member.name, -1, member.node
            if isinstance(element, nodes.ArrayNode | nodes.SequenceNode):
                number, element = element.capacity, element.element
            kind = getattr(element, "kind", "string")
            if isinstance(element, nodes.StructNode):
                kind = struct(element)
            # A field may be a Python keyword: it can be had with an underscore, as rosbags does.
            other = f"{name}_" if keyword.iskeyword(name) else None
            if node.type_name in _TIMES:
                other = _GENPY[name]
            fields.append((name, other, kind, member.offset, element.size, number, counts.get(name, -1)))
        message = store[node.type_name]
        defaults = {field.name: field.default for field in message.fields if field.default is not None}
        known[id(node)] = shape = Shape(node.type_name, node.size, tuple(fields), defaults, RecordView)
        return shape

    return struct(root)
