"""Record bytes → values, read when they are asked for."""

from __future__ import annotations

import keyword
import struct
from collections.abc import Callable, Iterable
from typing import Any, ClassVar, NoReturn, TypeAlias

from rosplc.layout import nodes
from rosplc.model.types import FORMATS

_Read: TypeAlias = "Callable[[memoryview, int], Any]"
_COUNT = struct.Struct("<I")
_SHOWN = 8


class Excerpt(list[Any]):
    """The first elements of an array that is longer."""

    def __init__(self, elements: Iterable[Any], length: int) -> None:
        super().__init__(elements)
        self.length = length  # how many elements the array has


class StructReader:
    """How to read each field, made once per layout; arrays above ``most`` become an :class:`Excerpt`."""

    def __init__(self, node: nodes.StructNode, most: int | None = None) -> None:
        self.type_name = node.type_name
        self.fields = {
            member.name: property(_getter(member, node, most))
            for member in node.members
            if not isinstance(member.node, nodes.PaddingNode) and member.count_of is None
        }
        # A field may be a Python keyword: it can be had with an underscore, as rosbags does.
        self.aliases = {f"{name}_": name for name in self.fields if keyword.iskeyword(name)}
        # A class per struct: Python finds a property much faster than it calls __getattr__.
        self.view: type[RecordView] = type(
            "RecordView", (RecordView,), {"__slots__": (), "_reader": self, **self.fields}
        )


class RecordView:
    """A message in a record: its fields are attributes, read from the bytes at each access.

    A view does not copy: over a buffer that changes, its values change (``copy.deepcopy``
    gives one that stays). Nested messages are
    views, arrays and sequences are lists (of values, or of views), strings are ``str``; bytes
    that are no UTF-8 become surrogates (``surrogateescape``), and packing such a string gives
    the same bytes again. A count above a sequence's capacity reads as the capacity, and a
    string ends at its NUL or its capacity. Two views are equal if all their fields are.
    """

    __slots__ = ("_buffer", "_offset")

    _reader: ClassVar[StructReader]
    _buffer: memoryview
    _offset: int

    def __init__(self, buffer: memoryview, offset: int) -> None:
        _put_buffer(self, buffer)
        _put_offset(self, offset)

    def __getattr__(self, name: str) -> Any:
        if name.startswith("_"):  # no field does
            raise AttributeError(f"a record has no {name!r}", name=name, obj=self)
        if (original := self._reader.aliases.get(name)) is None:
            raise AttributeError(f"{self._reader.type_name} has no field {name!r}", name=name, obj=self)
        return getattr(self, original)

    def __setattr__(self, name: str, value: object) -> NoReturn:
        raise AttributeError("records are read through views and written by packing a new one")

    def __copy__(self) -> RecordView:
        """Return another view of the same bytes."""
        return type(self)(self._buffer, self._offset)

    def __deepcopy__(self, memo: dict[int, Any]) -> RecordView:
        """Return a view of a copy of the bytes, which stays as it is."""
        return type(self)(memoryview(bytes(self._buffer)), self._offset)

    def __dir__(self) -> list[str]:
        return [*self._reader.fields, *self._reader.aliases]

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, RecordView):
            return NotImplemented
        names = self._reader.fields
        return (
            self._reader.type_name == other._reader.type_name
            and names.keys() == other._reader.fields.keys()
            and all(getattr(self, name) == getattr(other, name) for name in names)
        )

    __hash__ = None  # type: ignore[assignment]

    def __repr__(self) -> str:
        short = self._reader.type_name.rsplit("/", 1)[1]
        fields = ", ".join(f"{name}={_show(getattr(self, name))}" for name in self._reader.fields)
        return f"{short}({fields})"


# As object.__setattr__, without a search for the name.
_put_buffer: Any = RecordView.__dict__["_buffer"].__set__
_put_offset: Any = RecordView.__dict__["_offset"].__set__


def _getter(member: nodes.Member, parent: nodes.StructNode, most: int | None) -> Callable[[RecordView], Any]:
    node, start = member.node, member.offset
    if isinstance(node, nodes.ScalarNode) and node.kind != "bool":
        get = struct.Struct("<" + FORMATS[node.kind]).unpack_from
        return lambda view: get(view._buffer, view._offset + start)[0]
    read = _reader(member, parent, most)
    return lambda view: read(view._buffer, view._offset + start)


def plain(value: Any) -> Any:
    """Return a view, or a list of views, as dicts and lists."""
    if isinstance(value, RecordView):
        return {name: plain(getattr(value, name)) for name in value._reader.fields}
    if isinstance(value, list) and value and isinstance(value[0], RecordView):
        items = [plain(item) for item in value]
        return Excerpt(items, value.length) if isinstance(value, Excerpt) else items
    return value


def _show(value: Any) -> str:
    if isinstance(value, list) and len(value) > _SHOWN:
        shown = ", ".join(repr(item) for item in value[:_SHOWN])
        return f"[{shown}, … {len(value) - _SHOWN} more]"
    return repr(value)


def _reader(member: nodes.Member, parent: nodes.StructNode, most: int | None) -> _Read:
    node = member.node
    if not isinstance(node, nodes.ArrayNode | nodes.SequenceNode):
        return _single(node, most)
    read, capacity = _elements(node.element, most), node.capacity
    if isinstance(node, nodes.ArrayNode):
        return lambda buffer, offset: read(buffer, offset, capacity)
    count = next(m.offset for m in parent.members if m.count_of == member.name) - member.offset
    get = _COUNT.unpack_from
    return lambda buffer, offset: read(buffer, offset, min(get(buffer, offset + count)[0], capacity))


def _single(node: nodes.Node, most: int | None) -> _Read:
    if isinstance(node, nodes.StructNode):
        return StructReader(node, most).view
    if isinstance(node, nodes.StringNode):
        return _string(node.capacity)
    assert isinstance(node, nodes.ScalarNode)
    if node.kind == "bool":
        return lambda buffer, offset: buffer[offset] != 0
    unpack_from = struct.Struct("<" + FORMATS[node.kind]).unpack_from
    return lambda buffer, offset: unpack_from(buffer, offset)[0]


def _string(capacity: int) -> _Read:
    get = struct.Struct(f"{capacity}s").unpack_from

    def read(buffer: memoryview, offset: int) -> str:
        data: bytes = get(buffer, offset)[0].split(b"\0", 1)[0]
        return data.decode("utf-8", "surrogateescape")

    return read


def _elements(
    node: nodes.ScalarNode | nodes.StringNode | nodes.StructNode, most: int | None
) -> Callable[[memoryview, int, int], list[Any]]:
    if isinstance(node, nodes.ScalarNode) and node.kind != "bool":
        code = FORMATS[node.kind]

        def read(buffer: memoryview, offset: int, size: int) -> list[Any]:
            return [*struct.unpack_from(f"<{size}{code}", buffer, offset)]
    else:
        single, stride = _single(node, most), node.size

        def read(buffer: memoryview, offset: int, size: int) -> list[Any]:
            return [single(buffer, offset + index * stride) for index in range(size)]

    def read_first(buffer: memoryview, offset: int, size: int) -> list[Any]:
        assert most is not None
        return Excerpt(read(buffer, offset, most), size) if size > most else read(buffer, offset, size)

    return read if most is None else read_first
