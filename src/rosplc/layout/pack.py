"""Values → record bytes.

Each node becomes a function once per layout; a record is then written by calling them, not
by looking at nodes again. Numbers in bulk go through :mod:`struct` or, if they already lie
in memory as the record wants them (bytes, array, numpy), are copied as they are.
"""

from __future__ import annotations

import keyword
import operator
import struct
import sys
from collections.abc import Callable, Iterable, Mapping
from typing import TYPE_CHECKING, Any, TypeAlias

from rosplc.layout.nodes import ArrayNode, PaddingNode, ScalarNode, SequenceNode, StringNode, StructNode

if TYPE_CHECKING:
    from rosplc.layout.nodes import Member, Node
    from rosplc.model import TypeStore

__all__ = ["FORMATS", "Misfit", "StructPacker"]

FORMATS = {
    "bool": "?", "byte": "B", "char": "B", "uint8": "B", "int8": "b", "uint16": "H", "int16": "h",
    "uint32": "I", "int32": "i", "uint64": "Q", "int64": "q", "float32": "f", "float64": "d",
}  # fmt: skip
"""Primitive → :mod:`struct` format character."""

_Pack: TypeAlias = "Callable[[bytearray, int, Any], None]"
_MISSING = object()
_COUNT = struct.Struct("<I")
# genpy's own classes name the two words of a time differently, and count nsecs signed.
_GENPY = {"sec": "secs", "nanosec": "nsecs"}
_BUFFER_LETTERS = frozenset("bBhHiIlLqQfd?")
_TIMES = ("builtin_interfaces/msg/Time", "builtin_interfaces/msg/Duration")


class Misfit(Exception):
    """A value does not fit; ``path`` grows from the inside out while this travels up."""

    def __init__(self, what: str) -> None:
        super().__init__(what)
        self.what = what
        self.path: list[str] = []

    def where(self) -> str:
        """Return the field path, such as ``points[3].x``."""
        text = ""
        for part in reversed(self.path):
            text += part if part.startswith("[") or not text else f".{part}"
        return text


class StructPacker:
    """Writes values into a struct's bytes.

    Args:
        node: The struct.
        store: Knows the default values.

    Attributes:
        initial: The struct's bytes when no field is given.
    """

    def __init__(self, node: StructNode, store: TypeStore) -> None:
        self._type_name = node.type_name
        self._fields: dict[str, tuple[int, _Pack]] = {}
        self.initial = bytes(node.size)
        message = store[node.type_name]
        defaults = {field.name: field.default for field in message.fields if field.default is not None}
        image = bytearray(node.size)
        for member in node.members:
            if isinstance(member.node, PaddingNode) or member.count_of is not None:
                continue
            pack, start = _packer(member, node, store)
            self._fields[member.name] = (member.offset, pack)
            _put_initial(image, member, start)
            if member.name in defaults:
                pack(image, member.offset, defaults[member.name])
        self.initial = bytes(image)

    def __call__(self, buffer: bytearray, offset: int, value: Any) -> None:
        """Write ``value``'s fields; those that it lacks keep what ``buffer`` has.

        Raises:
            Misfit: A value does not fit its field.
        """
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
            raise Misfit(f"{_describe(value)} is no {self._type_name}")

    def _by_other_name(self, value: Any, name: str) -> Any:
        if keyword.iskeyword(name):
            return getattr(value, f"{name}_", _MISSING)
        if self._type_name in _TIMES and isinstance(number := getattr(value, _GENPY[name], None), int):
            wrapped = number & 0xFFFFFFFF
            return wrapped - (1 << 32) if name == "sec" and wrapped >= 1 << 31 else wrapped
        return _MISSING


def _packer(member: Member, parent: StructNode, store: TypeStore) -> tuple[_Pack, bytes]:
    """Return how to write a member, and its initial bytes without its own default value."""
    node = member.node
    if isinstance(node, SequenceNode):
        count = next(m.offset for m in parent.members if m.count_of == member.name)
        return _sequence(node, count - member.offset, store), b""
    if isinstance(node, StructNode):
        inner = StructPacker(node, store)
        return inner, inner.initial
    if isinstance(node, ArrayNode):
        return _array(node, store)
    return _single(node), b""


def _put_initial(image: bytearray, member: Member, start: bytes) -> None:
    image[member.offset : member.offset + len(start)] = start


def _single(node: Node) -> _Pack:
    if isinstance(node, StringNode):
        return _string(node.capacity)
    assert isinstance(node, ScalarNode)
    return _scalar(node.kind)


def _scalar(kind: str) -> _Pack:
    pack_into = struct.Struct("<" + FORMATS[kind]).pack_into
    convert = _converter(kind)

    def pack(buffer: bytearray, offset: int, value: Any) -> None:
        try:
            pack_into(buffer, offset, convert(value))
        except (TypeError, ValueError, OverflowError, struct.error):
            raise Misfit(f"{_describe(value)} is no {kind}") from None

    return pack


def _converter(kind: str) -> Callable[[Any], Any]:
    if kind == "bool":
        return _to_bool
    if kind in ("float32", "float64"):
        return _to_float
    return _to_octet if kind in ("byte", "char") else operator.index


def _to_bool(value: Any) -> bool:
    # numpy's bool has neither __index__ nor bool as its base.
    if isinstance(value, bool) or type(value).__name__ in ("bool_", "bool"):
        return bool(value)
    number = operator.index(value)
    if number not in (0, 1):
        raise ValueError
    return number == 1


def _to_float(value: Any) -> float:
    if isinstance(value, str | bytes | bytearray):
        raise TypeError
    return float(value)


def _to_octet(value: Any) -> int:
    if isinstance(value, bytes) and len(value) == 1:  # rclpy's form of a byte
        return value[0]
    number = operator.index(value)
    return number + 256 if -128 <= number < 0 else number  # rospy's byte is signed


def _string(capacity: int) -> _Pack:
    def pack(buffer: bytearray, offset: int, value: Any) -> None:
        if isinstance(value, str):
            try:
                data = value.encode("utf-8", "surrogateescape")
            except UnicodeEncodeError:
                raise Misfit(f"{_describe(value)} is no Unicode text") from None
        elif isinstance(value, bytes | bytearray):
            data = bytes(value)
        else:
            raise Misfit(f"{_describe(value)} is no string")
        if b"\0" in data:
            raise Misfit("a string cannot hold a NUL")
        if len(data) > capacity:
            raise Misfit(f"the string has {len(data)} bytes, its limit is {capacity}")
        buffer[offset : offset + capacity + 1] = data.ljust(capacity + 1, b"\0")

    return pack


def _array(node: ArrayNode, store: TypeStore) -> tuple[_Pack, bytes]:
    fill, initial = _elements(node.element, store)

    def pack(buffer: bytearray, offset: int, value: Any) -> None:
        items = _items(value)
        if len(items) != node.length:
            raise Misfit(f"{len(items)} elements for an array of {node.length}")
        fill(buffer, offset, items)

    return pack, initial * node.length


def _sequence(node: SequenceNode, count: int, store: TypeStore) -> _Pack:
    fill, initial = _elements(node.element, store)
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


def _elements(
    node: ScalarNode | StringNode | StructNode, store: TypeStore
) -> tuple[Callable[[bytearray, int, Any], None], bytes]:
    """Return how to write elements from a sized collection, and one element's initial bytes."""
    if isinstance(node, StructNode):
        inner = StructPacker(node, store)
        return _each(inner, node.size), inner.initial
    if isinstance(node, StringNode):
        return _each(_string(node.capacity), node.size), b""
    return _numbers(node), b""


def _each(pack: _Pack, stride: int) -> Callable[[bytearray, int, Any], None]:
    def fill(buffer: bytearray, offset: int, items: Any) -> None:
        for index, item in enumerate(items):
            try:
                pack(buffer, offset + index * stride, item)
            except Misfit as misfit:
                misfit.path.append(f"[{index}]")
                raise

    return fill


def _numbers(node: ScalarNode) -> Callable[[bytearray, int, Any], None]:
    one_by_one = _each(_scalar(node.kind), node.size)
    code = FORMATS[node.kind]
    same = _buffer_formats(code, node.size)

    def fill(buffer: bytearray, offset: int, items: Any) -> None:
        if isinstance(items, memoryview):
            if items.format in same and items.itemsize == node.size:
                native = items.c_contiguous and len(items.format) == 1
                data = items.cast("B") if native else items.tobytes()
                buffer[offset : offset + items.nbytes] = data
                return
            items = items.tolist()
        if code != "?":  # struct takes the truth of anything as a bool
            try:
                struct.pack_into(f"<{len(items)}{code}", buffer, offset, *items)
            except (TypeError, ValueError, OverflowError, struct.error):
                pass  # some element needs conversion, or does not fit: find out which
            else:
                return
        one_by_one(buffer, offset, items)

    return fill


def _buffer_formats(code: str, size: int) -> frozenset[str]:
    """Return the buffer formats whose bytes are the record's bytes already."""
    if sys.byteorder != "little":  # pragma: no cover - no big-endian machine at hand
        return frozenset()
    classes = ("bhilq", "BHILQ", "fd", "?")
    letters = next(letters for letters in classes if code in letters) if size > 1 else code
    return frozenset(prefix + letter for letter in letters for prefix in ("", "<", "=", "@"))


def _items(value: Any) -> Any:
    """Return a collection with a length: a one-dimensional memoryview, a list or a tuple."""
    if isinstance(value, list | tuple):
        return value
    if isinstance(value, str | Mapping):
        raise Misfit(f"{_describe(value)} is no sequence")
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
        raise Misfit(f"{_describe(value)} is no sequence")
    return value if isinstance(value, list) else list(value)


def _describe(value: Any) -> str:
    text = repr(value)
    return f"{text if len(text) <= 60 else text[:57] + '...'} ({type(value).__name__})"
