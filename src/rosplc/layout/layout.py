"""A type's layout: the one object that codec, generator, monitor and tests ask."""

from __future__ import annotations

import hashlib
from collections.abc import Iterator, Mapping
from functools import cached_property
from typing import Any, TypeAlias

from rosplc._core import Shape
from rosplc.layout.nodes import Limits, Node, StructNode, compute_struct, layout_difference, layout_text, walk
from rosplc.layout.view import Excerpt, RecordView, shape_of
from rosplc.model import TypeStore

Buffer: TypeAlias = "bytes | bytearray | memoryview"


def compute_layout(store: TypeStore, type_name: str, limits: Limits | None = None) -> Layout:
    """Return the layout of a type with its limits applied; ``store`` knows it and those it needs.

    ``type_name`` is ``package/msg/Name`` or ``package/Name``; without ``limits`` a string has 80 bytes and a
    sequence 16 elements. Raises MessageTypeError TYP001, the type is unknown; LayoutError LAY001 … LAY004
    (spec/type-mapping.md), or LAY006, a default value of the definition needs a larger capacity.
    """
    limits = limits or Limits()
    return Layout(store, compute_struct(store, type_name, limits), limits)


class Layout:
    """Where each part of a record lies, and what follows from that.

    Attributes:
        store: The types that it was computed from.
        root: The record as a struct node.
        limits: The capacities that were asked for.
    """

    def __init__(self, store: TypeStore, root: StructNode, limits: Limits) -> None:
        self.store = store
        self.root = root
        self.limits = limits

    def __reduce__(self) -> tuple[object, ...]:
        return Layout, (self.store, self.root, self.limits)  # not what was computed from these

    def __repr__(self) -> str:
        return f"Layout({self.type_name}, {self.size} bytes, {self.layout_id})"

    def __eq__(self, other: object) -> bool:
        return self.text == other.text if isinstance(other, Layout) else NotImplemented

    def __hash__(self) -> int:
        return hash(self.text)

    @property
    def type_name(self) -> str:
        """The type's full name."""
        return self.root.type_name

    @property
    def size(self) -> int:
        """The record's size in bytes."""
        return self.root.size

    @property
    def align(self) -> int:
        """The record's alignment in bytes."""
        return self.root.align

    @cached_property
    def text(self) -> str:
        """The layout text (spec/type-mapping.md, section 5)."""
        return layout_text(self.root)

    @cached_property
    def layout_id(self) -> str:
        """The layout id as 16 hexadecimal digits in byte order."""
        return hashlib.sha256(self.text.encode()).digest()[:8].hex()

    @property
    def layout_id_words(self) -> tuple[int, int]:
        """The layout id as the header's words ``(layout_id_lo, layout_id_hi)``."""
        data = bytes.fromhex(self.layout_id)
        return int.from_bytes(data[:4], "little"), int.from_bytes(data[4:], "little")

    def fields(self) -> Iterator[tuple[str, int, Node]]:
        """Yield path, offset in the record and node of every scalar, string, array and sequence.

        An array or sequence is followed by its element, whose path ends with ``[]`` and whose
        offset is the first one's. Structs, padding and counts are left out.
        """
        return walk(self.root)

    def difference(self, other: Layout | str) -> str:
        """Say in words how another layout, or its text, differs; empty if it does not."""
        return layout_difference(self.text, other if isinstance(other, str) else other.text)

    def initial(self) -> bytes:
        """Return the record of a message that nobody has filled: its default values, else zeros."""
        return self.shape.initial

    def pack(self, value: Mapping[str, Any] | RecordView | object) -> bytearray:
        """Return the record of a message. Raises LayoutError LAY006, naming the field's path.

        ``value`` is a mapping, a view, or any object with the fields as attributes (a ROS message, a rosbags
        message), nested as the type is. What it lacks takes its initial value. Numbers in bulk are fastest as
        bytes, array.array or numpy arrays of the field's own type.
        """
        return self.shape.pack(value)

    def pack_into(
        self, value: Mapping[str, Any] | RecordView | object, buffer: bytearray | memoryview
    ) -> None:
        """Write the record of a message into a buffer of at least ``size`` bytes.

        The buffer changes only if all fits. Raises LayoutError LAY006: a value, or the buffer, does not.
        """
        self.shape.view(buffer)  # or it is refused
        memoryview(buffer).cast("B")[: self.size] = self.shape.pack(value)

    def view(self, buffer: Buffer) -> RecordView:
        """Return a view that reads from ``buffer`` at each access; LAY006: it is smaller than a record."""
        return self.shape.view(buffer)  # type: ignore[return-value] # of the class that it was given

    def to_dict(self, buffer: Buffer) -> dict[str, Any]:
        """Return a record as nested dicts and lists, with the fields in their order."""
        return self.shape.view(buffer)._to_dict()

    def excerpt(self, buffer: Buffer, elements: int) -> dict[str, Any]:
        """Return a record as :meth:`to_dict` does, arrays with so many of their first elements at most.

        It costs what it returns, where a picture or a point cloud would be a million numbers. An array that
        is longer becomes an :class:`rosplc.layout.view.Excerpt`, a list that knows the whole length.
        """
        return self.shape.view(buffer)._to_dict(elements, Excerpt)

    @cached_property
    def shape(self) -> Shape:
        """What packs and reads records, in the C core."""
        return shape_of(self.root, self.store)
