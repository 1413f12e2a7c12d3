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
    """Return the layout of a type with these limits; ``store`` contains the type and its dependencies.

    ``type_name`` is ``package/msg/Name`` or ``package/Name``. Without ``limits``, strings have 80 bytes and
    sequences 16 elements. Raises MessageTypeError TYP001 if the type is unknown; LayoutError LAY001 … LAY004
    (spec/type-mapping.md), or LAY006 if a default value in the definition needs a larger capacity.
    """
    limits = limits or Limits()
    return Layout(store, compute_struct(store, type_name, limits), limits)


class Layout:
    """The offset and size of each part of a record.

    Attributes:
        store: The types from which the layout was computed.
        root: The record as a struct node.
        limits: The requested capacities.
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
        """Yield the path, offset and node of every scalar, string, array and sequence in the record.

        An array or sequence is followed by its element, whose path ends with ``[]`` and whose
        offset is that of the first element. Structs, padding and counts are omitted.
        """
        return walk(self.root)

    def difference(self, other: Layout | str) -> str:
        """Describe how another layout, or its text, differs; empty if it does not."""
        return layout_difference(self.text, other if isinstance(other, str) else other.text)

    def initial(self) -> bytes:
        """Return the record of a message with initial values: the defaults of the definition, else zeros."""
        return self.shape.initial

    def pack(self, value: Mapping[str, Any] | RecordView | object) -> bytearray:
        """Return the record of a message. Raises LayoutError LAY006 with the field's path.

        ``value`` is a mapping, a view, or any object with the fields as attributes (a ROS message, a rosbags
        message), nested like the type. Missing fields have their initial values. Large arrays are packed
        fastest from bytes, array.array or numpy arrays of the field's own type.
        """
        return self.shape.pack(value)

    def pack_into(
        self, value: Mapping[str, Any] | RecordView | object, buffer: bytearray | memoryview
    ) -> None:
        """Write the record of a message into a buffer of at least ``size`` bytes.

        The buffer changes only if all fits. Raises LayoutError LAY006 if a value or the record does not fit.
        """
        self.shape.view(buffer)  # or it is refused
        memoryview(buffer).cast("B")[: self.size] = self.shape.pack(value)

    def view(self, buffer: Buffer) -> RecordView:
        """Return a view that reads from ``buffer`` at each access; LAY006 if it is smaller than a record."""
        return self.shape.view(buffer)  # type: ignore[return-value] # of the class that it was given

    def to_dict(self, buffer: Buffer) -> dict[str, Any]:
        """Return a record as nested dicts and lists, with the fields in their order."""
        return self.shape.view(buffer)._to_dict()

    def excerpt(self, buffer: Buffer, elements: int) -> dict[str, Any]:
        """Return a record like :meth:`to_dict`, but at most the first ``elements`` elements of each array.

        This is fast even for an image or a point cloud with a million numbers. A longer array becomes an
        :class:`rosplc.layout.view.Excerpt`, a list that also stores the full length.
        """
        return self.shape.view(buffer)._to_dict(elements, Excerpt)

    @cached_property
    def shape(self) -> Shape:
        """What packs and reads records, in the C core."""
        return shape_of(self.root, self.store)
