"""What tells types apart on the wire: ROS 2's RIHS01, ROS 1's MD5.

RIHS01 is REP-2016's hash of the type description as JSON; the numbers are
``type_description_interfaces/msg/FieldType``'s. ROS 1's MD5 is over the definition without comments,
constants first, with nested types replaced by their own MD5.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable
from typing import Any

from rosplc.model import types as kinds
from rosplc.model._rosbags import EMPTY_MEMBER
from rosplc.model.types import MessageType

# Types that ROS 1 has built in, under another name.
ROS1_TIMES = {"builtin_interfaces/msg/Time": "time", "builtin_interfaces/msg/Duration": "duration"}

# `char` is 3, not FieldType's own 13: rosidl turns a .msg file's char into uint8 first.
_TYPE_IDS = {
    "int8": 2, "uint8": 3, "char": 3, "int16": 4, "uint16": 5, "int32": 6, "uint32": 7,
    "int64": 8, "uint64": 9, "float32": 10, "float64": 11, "bool": 15, "byte": 16,
}  # fmt: skip
_NESTED, _STRING, _BOUNDED_STRING = 1, 17, 21
_WRITTEN = {number: name for name, number in _TYPE_IDS.items() if name != "char"}
# What is not carried is written as well, so that the parser of definitions names it.
_WRITTEN |= {12: "float128", 14: "wchar", _STRING: "string", 18: "wstring", 22: "wstring"}
_ARRAY, _BOUNDED_SEQUENCE, _SEQUENCE = 48, 96, 144  # added to the element's id


def rihs01(message: MessageType, dependencies: list[MessageType]) -> str:
    """Return the type hash ``RIHS01_<64 hexadecimal digits>``; dependencies are direct and indirect ones."""
    description = {
        "type_description": _describe(message),
        "referenced_type_descriptions": [
            _describe(other) for other in sorted(dependencies, key=lambda m: m.name)
        ],
    }
    return "RIHS01_" + hashlib.sha256(json.dumps(description).encode()).hexdigest()


def type_text(type_id: int, capacity: int, string_capacity: int, nested_type_name: str) -> str:
    """Return how a definition writes the type that a FieldType describes; an unknown one becomes no type."""
    length, number = divmod(type_id, _ARRAY)
    element = nested_type_name.replace("/msg/", "/") if number == _NESTED else _WRITTEN.get(number, "?")
    if number == _BOUNDED_STRING:
        element = f"string<={string_capacity}"
    return element + ("", f"[{capacity}]", f"[<={capacity}]", "[]", "?", "?")[length]


def md5_text(message: MessageType, md5_of: Callable[[str], str]) -> str:
    """Return the text whose MD5 identifies a type in ROS 1; ``md5_of`` gives that of a nested type."""
    lines = [f"{c.type} {c.name}={c.text}" for c in message.constants]
    for field in message.fields:
        kind, element = field.type, field.type.inner
        if isinstance(element, kinds.NamedType) and element.name not in ROS1_TIMES:
            lines.append(f"{md5_of(element.name)} {field.name}")  # brackets are left out there
        elif isinstance(element, kinds.NamedType):
            lines.append(f"{str(kind).replace(element.name, ROS1_TIMES[element.name])} {field.name}")
        else:
            lines.append(f"{kind} {field.name}")
    return "\n".join(lines)


def _describe(message: MessageType) -> dict[str, Any]:
    fields = message.fields or (kinds.Field(EMPTY_MEMBER, kinds.PrimitiveType("uint8")),)
    return {"type_name": message.name, "fields": [_describe_field(field) for field in fields]}


def _describe_field(field: kinds.Field) -> dict[str, Any]:
    kind: kinds.FieldType = field.type
    offset = capacity = string_capacity = 0
    if isinstance(kind, kinds.ArrayType):
        offset, capacity, kind = _ARRAY, kind.length, kind.element
    elif isinstance(kind, kinds.SequenceType):
        offset = _SEQUENCE if kind.bound is None else _BOUNDED_SEQUENCE
        capacity, kind = kind.bound or 0, kind.element
    if isinstance(kind, kinds.NamedType):
        number = _NESTED
    elif isinstance(kind, kinds.StringType):
        number, string_capacity = _STRING if kind.bound is None else _BOUNDED_STRING, kind.bound or 0
    else:
        number = _TYPE_IDS[str(kind)]
    # The order of the keys is part of the hash.
    own = {"type_id": offset + number, "capacity": capacity, "string_capacity": string_capacity}
    nested = kind.name if isinstance(kind, kinds.NamedType) else ""
    return {"name": field.name, "type": {**own, "nested_type_name": nested}}
