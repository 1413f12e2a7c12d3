"""Values → record bytes: each node becomes a function once per layout, and is not looked at again."""

from __future__ import annotations

import keyword
import struct
from collections.abc import Iterable, Mapping
from typing import TYPE_CHECKING, Any

from rosplc.layout.nodes import ArrayNode, PaddingNode, ScalarNode, SequenceNode, StringNode, StructNode
from rosplc.layout.numbers import Misfit, Pack, describe, each_packer, numbers_packer, scalar_packer

if TYPE_CHECKING:
    from rosplc.layout.nodes import Node
    from rosplc.model import TypeStore


_MISSING = object()
_COUNT = struct.Struct("<I")
# genpy's own classes name the two words of a time differently, and count nsecs signed.
_GENPY = {"sec": "secs", "nanosec": "nsecs"}
_BUFFER_LETTERS = frozenset("bBhHiIlLqQfd?")
_TIMES = ("builtin_interfaces/msg/Time", "builtin_interfaces/msg/Duration")


class StructPacker:
    """Writes values into a struct's bytes; ``initial`` are those when no field is given."""

    def __init__(self, node: StructNode, store: TypeStore) -> None:
        self._type_name = node.type_name
        self._fields: dict[str, tuple[int, Pack]] = {}
        self.initial = bytes(node.size)
        message = store[node.type_name]
        defaults = {field.name: field.default for field in message.fields if field.default is not None}
        image = bytearray(node.size)
        for member in node.members:
            if isinstance(member.node, PaddingNode) or member.count_of is not None:
                continue
            count = next((m.offset for m in node.members if m.count_of == member.name), 0) - member.offset
            pack, start = _packer(member.node, count, store)
            self._fields[member.name] = (member.offset, pack)
            image[member.offset : member.offset + len(start)] = start
            if member.name in defaults:
                pack(image, member.offset, defaults[member.name])
        self.initial = bytes(image)

    def __call__(self, buffer: bytearray, offset: int, value: Any) -> None:
        """Write ``value``'s fields; those that it lacks keep what ``buffer`` has. Raises Misfit."""
        if isinstance(value, Mapping):
            self._from_mapping(buffer, offset, value)
        else:
            self._from_object(buffer, offset, value)

    def _from_mapping(self, buffer: bytearray, offset: int, value: Mapping[Any, Any]) -> None:
        for name, item in value.items():
            known = self._fields.get(name)
            if known is None:
                raise Misfit(f"{self._type_name} has no field {name!r}")
            start, pack = known
            try:
                pack(buffer, offset + start, item)
            except Misfit as misfit:
                misfit.path.append(name)
                raise

    def _from_object(self, buffer: bytearray, offset: int, value: Any) -> None:
        found = not self._fields
        for name, (start, pack) in self._fields.items():
            item = getattr(value, name, _MISSING)
            if item is _MISSING:
                item = self._by_other_name(value, name)
                if item is _MISSING:
                    continue
            found = True
            try:
                pack(buffer, offset + start, item)
            except Misfit as misfit:
                misfit.path.append(name)
                raise
        if not found:
            raise Misfit(f"{describe(value)} is no {self._type_name}")

    def _by_other_name(self, value: Any, name: str) -> Any:
        if keyword.iskeyword(name):
            return getattr(value, f"{name}_", _MISSING)
        if self._type_name in _TIMES and isinstance(number := getattr(value, _GENPY[name], None), int):
            wrapped = number & 0xFFFFFFFF
            return wrapped - (1 << 32) if name == "sec" and wrapped >= 1 << 31 else wrapped
        return _MISSING


def _packer(node: Node, count: int, store: TypeStore) -> tuple[Pack, bytes]:
    """Return how to write a member, and its initial bytes but for its own default value.

    ``count`` is where the count of a sequence lies, from the sequence's own place.
    """
    if isinstance(node, StructNode):
        inner = StructPacker(node, store)
        return inner, inner.initial
    if isinstance(node, StringNode):
        return _string(node.capacity), b""
    if isinstance(node, ScalarNode):
        return scalar_packer(node.kind), b""
    assert isinstance(node, ArrayNode | SequenceNode)
    if isinstance(node.element, ScalarNode):
        fill, initial = numbers_packer(node.element), b""
    else:
        one, initial = _packer(node.element, 0, store)
        fill = each_packer(one, node.stride)
    if isinstance(node, SequenceNode):
        return _sequence(node, count, fill, initial), b""
    return _array(node.length, fill), initial * node.length


def _string(capacity: int) -> Pack:
    def pack(buffer: bytearray, offset: int, value: Any) -> None:
        if isinstance(value, str):
            try:
                data = value.encode("utf-8", "surrogateescape")
            except UnicodeEncodeError:
                raise Misfit(f"{describe(value)} is no Unicode text") from None
        elif isinstance(value, bytes | bytearray):
            data = bytes(value)
        else:
            raise Misfit(f"{describe(value)} is no string")
        if b"\0" in data:
            raise Misfit("a string cannot hold a NUL")
        if len(data) > capacity:
            raise Misfit(f"the string has {len(data)} bytes, its limit is {capacity}")
        buffer[offset : offset + capacity + 1] = data.ljust(capacity + 1, b"\0")

    return pack


def _array(length: int, fill: Pack) -> Pack:
    def pack(buffer: bytearray, offset: int, value: Any) -> None:
        items = _items(value)
        if len(items) != length:
            raise Misfit(f"{len(items)} elements for an array of {length}")
        fill(buffer, offset, items)

    return pack


def _sequence(node: SequenceNode, count: int, fill: Pack, initial: bytes) -> Pack:
    stride, capacity = node.stride, node.capacity

    def pack(buffer: bytearray, offset: int, value: Any) -> None:
        items = _items(value)
        size = len(items)
        if size > capacity:
            raise Misfit(f"{size} elements, the limit is {capacity}")
        before = min(_COUNT.unpack_from(buffer, offset + count)[0], capacity)
        if before > size:  # a default value that is longer: unused elements are zero
            buffer[offset + size * stride : offset + before * stride] = bytes((before - size) * stride)
        if initial:
            buffer[offset : offset + size * stride] = initial * size
        fill(buffer, offset, items)
        _COUNT.pack_into(buffer, offset + count, size)

    return pack


def _items(value: Any) -> Any:
    """Return a collection with a length: a one-dimensional memoryview, a list or a tuple."""
    if isinstance(value, list | tuple):
        return value
    if isinstance(value, str | Mapping):
        raise Misfit(f"{describe(value)} is no sequence")
    try:
        view = memoryview(value)
    except (TypeError, ValueError, BufferError):
        pass
    else:
        if view.ndim == 1 and view.format.lstrip("<=@") in _BUFFER_LETTERS:
            return view
    if hasattr(value, "tolist"):
        value = value.tolist()  # numpy: its own numbers would be converted one by one
    if not isinstance(value, Iterable):
        raise Misfit(f"{describe(value)} is no sequence")
    return value if isinstance(value, list) else list(value)
