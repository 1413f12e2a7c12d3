"""The one place that knows rosbags: bundled definitions, and the grammar of a field's type.

rosbags 0.x may change between minor versions, so it is pinned and adapted here to the model's dataclasses.
Its ``register()`` is never called, because it executes generated code; its line parser neither, because it
drops the text of constants (which ROS 1 hashes) and reads unquoted defaults loosely.
"""

from __future__ import annotations

from typing import Any

from rosbags.interfaces import Nodetype
from rosbags.typesys import Stores, get_typestore
from rosbags.typesys.base import BaseType, Cardinality
from rosbags.typesys.msg import MSGParser, normalize_type_ref
from rosbags.typesys.peg import Failure

from rosplc.model import types

_STORES = {
    "humble": Stores.ROS2_HUMBLE,
    "jazzy": Stores.ROS2_JAZZY,
    "kilted": Stores.ROS2_KILTED,
    "lyrical": Stores.ROS2_LYRICAL,
    "noetic": Stores.ROS1_NOETIC,
}

# The ROS distributions whose definitions are bundled.
DISTROS: tuple[str, ...] = tuple(_STORES)

# The member that ROS 2 adds to a message without fields; the model leaves it out.
EMPTY_MEMBER = "structure_needs_at_least_one_member"


def bundled_types(distro: str) -> dict[str, types.MessageType]:
    """Return every type that rosbags bundles for one of :data:`DISTROS`, without default values."""
    definitions: dict[str, Any] = get_typestore(_STORES[distro]).fielddefs
    ros1 = distro == "noetic"
    return {name: _message(name, *definition, ros1=ros1) for name, definition in definitions.items()}


def parse_field_type(text: str, package: str, *, ros1: bool = False) -> tuple[types.FieldType, bool] | None:
    """Read the type part of a ``.msg`` line, such as ``geometry_msgs/Point[<=4]``.

    An unqualified ``Header`` is std_msgs' one; another name without a package is that of ``package``. In
    ROS 1 ``byte`` is an ``int8``. Return the type, and whether its length and bounds are within 1 … 2^32 - 1;
    None if the text is no type at all.
    """
    parser = MSGParser(text)
    found = parser.typ(0)
    if isinstance(found, Failure) or found.pos != len(text):
        return None
    parsed = normalize_type_ref(f"{package}/msg/_", found.value)
    element: types.PrimitiveType | types.StringType | types.NamedType
    valid = True
    if isinstance(parsed.ref, BaseType):
        name = parsed.ref.name.value
        bounded = text.startswith("string<=")
        valid = not bounded or 0 < parsed.str_size < 1 << 32
        element = _element(Nodetype.BASE, (name, parsed.str_size), ros1)
    else:
        # rosbags knows no `package/srv/Name_Request`, which a service's event has.
        element = types.NamedType(parsed.ref.name.replace("/srv/msg/", "/srv/"))
    if parsed.cardinality is Cardinality.SCALAR:
        return element, valid
    unbounded = text.endswith("[]")
    valid = valid and (unbounded or 0 < parsed.size < 1 << 32)
    if parsed.cardinality is Cardinality.ARRAY:
        return types.ArrayType(element, parsed.size), valid
    return types.SequenceType(element, None if unbounded else parsed.size), valid


def _message(name: str, constants: list[Any], fields: list[Any], *, ros1: bool) -> types.MessageType:
    return types.MessageType(
        name,
        tuple(
            types.Field(n, _field_type(d[0], d[1], ros1))
            for n, d in fields
            if n != EMPTY_MEMBER or len(fields) > 1
        ),
        tuple(
            types.Constant(name, _element(Nodetype.BASE, (kind, 0), ros1), value, str(value))  # type: ignore[arg-type]
            for name, kind, value in constants
        ),
    )


def _field_type(kind: int, detail: Any, ros1: bool) -> types.FieldType:
    if kind == Nodetype.ARRAY:
        (inner_kind, inner), length = detail
        return types.ArrayType(_element(inner_kind, inner, ros1), length)
    if kind == Nodetype.SEQUENCE:
        (inner_kind, inner), bound = detail
        return types.SequenceType(_element(inner_kind, inner, ros1), bound or None)
    return _element(kind, detail, ros1)


def _element(kind: int, detail: Any, ros1: bool) -> types.PrimitiveType | types.StringType | types.NamedType:
    if kind == Nodetype.NAME:
        return types.NamedType(detail)
    name, bound = detail
    if name == "string":
        return types.StringType(bound or None)
    return types.ROS1_BYTE if ros1 and name == "byte" else types.PrimitiveType(name)
