"""Values → record bytes: each node becomes a function once per layout, and is not looked at again.

Bulk that lies in memory as the record wants it (bytes, array, numpy) is copied, else it goes through struct.
"""

from __future__ import annotations

import keyword
import operator
import struct
import sys
from collections.abc import Callable, Iterable, Iterator, Mapping
from typing import Any, TypeAlias

from rosplc.layout.nodes import ArrayNode, Node, PaddingNode, ScalarNode, SequenceNode, StringNode, StructNode
from rosplc.model import TypeStore
from rosplc.model.types import FORMATS

Pack: TypeAlias = "Callable[[bytearray, int, Any], None]"  # Writes a value at an offset.


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


def scalar_packer(kind: str) -> Pack:
    """Return how to write one value of a primitive."""
    pack_into = struct.Struct("<" + FORMATS[kind]).pack_into
    convert = _CONVERTERS.get(kind, operator.index)

    def pack(buffer: bytearray, offset: int, value: Any) -> None:
        try:
            pack_into(buffer, offset, convert(value))
        except (TypeError, ValueError, OverflowError, struct.error):
            raise Misfit(f"{describe(value)} is no {kind}") from None

    return pack


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


_CONVERTERS: dict[str, Callable[[Any], Any]] = {
    "bool": _to_bool, "byte": _to_octet, "char": _to_octet, "float32": _to_float, "float64": _to_float,
}  # fmt: skip


def each_packer(pack: Pack, stride: int) -> Callable[[bytearray, int, Any], None]:
    """Return how to write elements one after the other, naming the first that does not fit."""

    def fill(buffer: bytearray, offset: int, items: Any) -> None:
        for index, item in enumerate(items):
            try:
                pack(buffer, offset + index * stride, item)
            except Misfit as misfit:
                misfit.path.append(f"[{index}]")
                raise

    return fill


def numbers_packer(node: ScalarNode) -> Callable[[bytearray, int, Any], None]:
    """Return how to write a list, or a one-dimensional memoryview, of numbers."""
    one_by_one = each_packer(scalar_packer(node.kind), node.size)
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


def describe(value: Any) -> str:
    """Return a value and its type for an error, shortened."""
    text = repr(value)
    return f"{text if len(text) <= 60 else text[:57] + '...'} ({type(value).__name__})"


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
        self._together = _together(node)

    def __call__(self, buffer: bytearray, offset: int, value: Any) -> None:
        """Write ``value``'s fields; those that it lacks keep what ``buffer`` has. Raises Misfit."""
        if self._together is not None and type(value) is dict and len(value) == len(self._fields):
            pick, pack_into = self._together
            try:
                pack_into(buffer, offset, *pick(value))
            except (KeyError, TypeError, ValueError, OverflowError, struct.error):
                pass  # some value needs conversion, or does not fit: find out which
            else:
                return
        for name, item in value.items() if isinstance(value, Mapping) else self._attributes(value):
            if (known := self._fields.get(name)) is None:
                raise Misfit(f"{self._type_name} has no field {name!r}")
            start, pack = known
            try:
                pack(buffer, offset + start, item)
            except Misfit as misfit:
                misfit.path.append(name)
                raise

    def _attributes(self, value: Any) -> Iterator[tuple[str, Any]]:
        """Yield the fields that an object has as attributes; Misfit if there is none."""
        found = not self._fields
        for name in self._fields:
            item = getattr(value, name, _MISSING)
            if item is _MISSING:
                item = self._by_other_name(value, name)
            if item is not _MISSING:
                found = True
                yield name, item
        if not found:
            raise Misfit(f"{describe(value)} is no {self._type_name}")

    def _by_other_name(self, value: Any, name: str) -> Any:
        if keyword.iskeyword(name):
            return getattr(value, f"{name}_", _MISSING)
        if self._type_name in _TIMES and isinstance(number := getattr(value, _GENPY[name], None), int):
            wrapped = number & 0xFFFFFFFF
            return wrapped - (1 << 32) if name == "sec" and wrapped >= 1 << 31 else wrapped
        return _MISSING


def _together(node: StructNode) -> tuple[Callable[[Any], tuple[Any, ...]], Callable[..., None]] | None:
    """Return how to write a struct of two or more numbers at once, None for another."""
    code, names = "<", []
    for member in node.members:
        if isinstance(member.node, PaddingNode):
            code += f"{member.node.size}x"
        elif isinstance(member.node, ScalarNode) and member.node.kind != "bool" and member.count_of is None:
            code += FORMATS[member.node.kind]
            names.append(member.name)
        else:
            return None
    return (operator.itemgetter(*names), struct.Struct(code).pack_into) if len(names) > 1 else None


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
    return _array(node.capacity, fill), initial * node.capacity


def _string(capacity: int) -> Pack:
    put = struct.Struct(f"{capacity + 1}s").pack_into  # what is left is zero

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
        put(buffer, offset, data)

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
