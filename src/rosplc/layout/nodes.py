"""A layout as data: where each part of a record lies.

Offsets are bytes from the start of the enclosing struct, sizes are bytes. The rules are spec/type-mapping.md,
section 3; the numbers of every bundled type are compared with gcc's for x86-64, armhf and arm64.
"""

from __future__ import annotations

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


class _Elements:
    """Elements ``stride`` bytes apart: ``capacity`` of them have room."""

    __slots__ = ()
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


@dataclass(frozen=True, slots=True)
class ArrayNode(_Elements):
    """``length`` elements."""

    element: ScalarNode | StringNode | StructNode
    length: int

    @property
    def capacity(self) -> int:  # type: ignore[override]
        """The same as ``length``."""
        return self.length


@dataclass(frozen=True, slots=True)
class SequenceNode(_Elements):
    """``capacity`` elements; a ``uint32`` member of the struct with ``count_of`` has the number in use."""

    element: ScalarNode | StringNode | StructNode
    capacity: int
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
