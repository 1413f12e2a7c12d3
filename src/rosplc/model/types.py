"""A message type as data: frozen dataclasses, no behaviour beyond printing itself.

Names follow the ROS 2 interface definition (https://docs.ros.org, "About ROS 2 interfaces"): a type is
``package/msg/Name`` in both ROS versions.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TypeAlias

# Primitive name → size in bytes, which is its alignment too (spec/type-mapping.md).
PRIMITIVES: dict[str, int] = {
    "bool": 1, "byte": 1, "char": 1,
    "int8": 1, "uint8": 1, "int16": 2, "uint16": 2,
    "int32": 4, "uint32": 4, "int64": 8, "uint64": 8,
    "float32": 4, "float64": 8,
}  # fmt: skip

# Primitive → `struct` format character.
FORMATS = {
    "bool": "?", "byte": "B", "char": "B", "uint8": "B", "int8": "b", "uint16": "H", "int16": "h",
    "uint32": "I", "int32": "i", "uint64": "Q", "int64": "q", "float32": "f", "float64": "d",
}  # fmt: skip

Value: TypeAlias = "bool | int | float | str | tuple[Value, ...]"


class _Kind:
    __slots__ = ()

    @property
    def inner(self) -> PrimitiveType | StringType | NamedType:
        """The type of the elements of an array or sequence; any other type itself."""
        return self.element if isinstance(self, ArrayType | SequenceType) else self  # type: ignore[return-value]


@dataclass(frozen=True, slots=True)
class PrimitiveType(_Kind):
    """One of :data:`PRIMITIVES`. ``byte`` and ``char`` are unsigned 8-bit numbers.

    ``written`` is how the definition writes it, where that differs: ROS 1's ``byte`` is an ``int8``.
    """

    name: str
    written: str = ""

    def __str__(self) -> str:
        return self.written or self.name


ROS1_BYTE = PrimitiveType("int8", "byte")


@dataclass(frozen=True, slots=True)
class StringType(_Kind):
    """A string of UTF-8 bytes; ``bound`` is the definition's own limit in bytes, if any."""

    bound: int | None = None

    def __str__(self) -> str:
        return "string" if self.bound is None else f"string<={self.bound}"


@dataclass(frozen=True, slots=True)
class NamedType(_Kind):
    """Another message type, by its full name ``package/msg/Name``."""

    name: str

    def __str__(self) -> str:
        return self.name


@dataclass(frozen=True, slots=True)
class ArrayType(_Kind):
    """A fixed number of elements."""

    element: PrimitiveType | StringType | NamedType
    length: int

    def __str__(self) -> str:
        return f"{self.element}[{self.length}]"


@dataclass(frozen=True, slots=True)
class SequenceType(_Kind):
    """Any number of elements up to ``bound`` (the definition's own limit, if any)."""

    element: PrimitiveType | StringType | NamedType
    bound: int | None = None

    def __str__(self) -> str:
        return f"{self.element}[]" if self.bound is None else f"{self.element}[<={self.bound}]"


FieldType: TypeAlias = "PrimitiveType | StringType | NamedType | ArrayType | SequenceType"


@dataclass(frozen=True, slots=True)
class Field:
    """One field of a message; ``default`` is the definition's default value, if any."""

    name: str
    type: FieldType
    default: Value | None = None


@dataclass(frozen=True, slots=True)
class Constant:
    """One constant of a message; ``type`` is a primitive or a string.

    ``text`` is the value as the definition writes it: ROS 1 hashes that text, not the value.
    """

    name: str
    type: PrimitiveType | StringType
    value: bool | int | float | str
    text: str = field(default="", compare=False)


@dataclass(frozen=True, slots=True)
class MessageType:
    """A message definition: ``name`` is ``package/msg/Name``; fields in their wire order."""

    name: str
    fields: tuple[Field, ...]
    constants: tuple[Constant, ...] = field(default=())

    @property
    def needs(self) -> tuple[str, ...]:
        """The names of the types of its fields, each once, in their order."""
        inner = (field.type.inner for field in self.fields)
        return tuple(dict.fromkeys(kind.name for kind in inner if isinstance(kind, NamedType)))


@dataclass(frozen=True, slots=True)
class ServiceType:
    """A service: ``name`` is ``package/srv/Name``, or ``package/action/Name_SendGoal`` of an action.

    Its messages are called ``<name>_Request`` and ``<name>_Response``, in ROS 1 too.
    """

    name: str
    request: MessageType
    response: MessageType


@dataclass(frozen=True, slots=True)
class ActionType:
    """An action: ``name`` is ``package/action/Name``; its messages are ``<name>_Goal`` and so on."""

    name: str
    goal: MessageType
    result: MessageType
    feedback: MessageType
