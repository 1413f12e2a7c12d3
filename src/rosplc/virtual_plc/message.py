"""A message that a program fills, field by field, as a PLC program fills its struct."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NoReturn

from rosplc.layout import Layout, RecordView, StructNode

__all__ = ["Message"]


class Message:
    """A message with settable fields; ``Layout.pack`` accepts it.

    Nested messages are :class:`Message` objects, arrays and sequences are lists, strings are
    ``str``. A field that the type does not have cannot be set; whether a value fits its
    field shows when the message is packed.
    """

    __slots__ = ("_type_name", "_values")

    _type_name: str
    _values: dict[str, Any]

    def __init__(self, type_name: str, values: dict[str, Any]) -> None:
        put = object.__setattr__
        put(self, "_type_name", type_name)
        put(self, "_values", values)

    @classmethod
    def initial(cls, layout: Layout) -> Message:
        """Return a message with the type's default values."""
        return cls.of(layout, layout.view(layout.initial()))

    @classmethod
    def of(cls, layout: Layout, view: RecordView) -> Message:
        """Return a copy of a record that can be changed."""
        return _copy(layout.root, view)

    def update(self, values: Mapping[str, Any]) -> None:
        """Set the named fields; a mapping for a nested message sets only what it names.

        Raises:
            AttributeError: A name is no field of the type.
        """
        for name, value in values.items():
            present = getattr(self, name)
            if isinstance(present, Message) and isinstance(value, Mapping):
                present.update(value)
            else:
                self._values[name] = value

    def __getattr__(self, name: str) -> Any:
        if name.startswith("_"):  # no ROS field does; copy and pickle look for such names early
            raise AttributeError(name)
        try:
            return self._values[name]
        except KeyError:
            self._refuse(name)

    def __setattr__(self, name: str, value: Any) -> None:
        if name not in self._values:
            self._refuse(name)
        if isinstance(value, Mapping) and isinstance(self._values[name], Message):
            self._values[name].update(value)
        else:
            self._values[name] = value

    def __reduce__(self) -> tuple[object, ...]:
        # The usual way would set the slots by name, which __setattr__ refuses.
        return (Message, (self._type_name, self._values))

    def __dir__(self) -> list[str]:
        return [*super().__dir__(), *self._values]

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, Message):
            return NotImplemented
        return self._type_name == other._type_name and self._values == other._values

    __hash__ = None  # type: ignore[assignment]

    def __repr__(self) -> str:
        fields = ", ".join(f"{name}={value!r}" for name, value in self._values.items())
        return f"{self._type_name.rpartition('/')[2]}({fields})"

    def _refuse(self, name: str) -> NoReturn:
        fields = ", ".join(self._values) or "none"
        raise AttributeError(f"{self._type_name} has no field {name!r}; its fields: {fields}")


def _copy(node: StructNode, view: RecordView) -> Message:
    values = {}
    for member in node.members:
        if not member.name or member.count_of is not None:
            continue
        value = getattr(view, member.name)
        element = getattr(member.node, "element", member.node)
        if isinstance(element, StructNode):
            value = (
                [_copy(element, item) for item in value] if isinstance(value, list) else _copy(element, value)
            )
        values[member.name] = value
    return Message(node.type_name, values)
