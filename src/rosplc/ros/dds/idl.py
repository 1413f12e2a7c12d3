"""Message types in DDS: names, and the type information that a DDS topic needs.

ROS 2 maps ``pkg/msg/T`` to ``pkg::msg::dds_::T_`` with final structs, plain field names and
XCDR version 1; ``byte`` and ``char`` travel as octets
(https://design.ros2.org/articles/idl_interface_definition.html and rosidl's generators).
"""

from __future__ import annotations

import threading
from collections.abc import Mapping
from typing import Any

from cyclonedds.idl import make_idl_struct
from cyclonedds.idl import types as idl_types

from rosplc.model import TypeStore
from rosplc.model.types import ArrayType, FieldType, MessageType, NamedType, PrimitiveType, StringType
from rosplc.ros.names import dds_type_name

_PRIMITIVES: dict[str, Any] = {
    "bool": bool, "byte": idl_types.uint8, "char": idl_types.uint8,
    "int8": idl_types.int8, "uint8": idl_types.uint8, "int16": idl_types.int16, "uint16": idl_types.uint16,
    "int32": idl_types.int32, "uint32": idl_types.uint32,
    "int64": idl_types.int64, "uint64": idl_types.uint64,
    "float32": idl_types.float32, "float64": idl_types.float64,
}  # fmt: skip

_NO_HEADER: dict[str, Any] = {}
_HEADER = {"rmw_client_id": idl_types.uint64, "rmw_call_number": idl_types.int64}  # of rmw_cyclonedds_cpp

_PLACEHOLDER = "structure_needs_at_least_one_member"  # rosidl's member of a message without fields


def dds_topic(topic: str) -> str:
    """Return ``rt/cmd_vel`` for ``/cmd_vel``."""
    return f"rt{topic}"


def ros_topic(name: str) -> str | None:
    """Return the ROS topic of a DDS topic, or None if it is not a ROS topic (service, plain DDS)."""
    return name[2:] if name.startswith("rt/") else None


def service_topics(service: str) -> tuple[str, str]:
    """Return ``rq/addRequest`` and ``rr/addReply`` for ``/add``."""
    return f"rq{service}Request", f"rr{service}Reply"


def ros_service(topic: str) -> str | None:
    """Return the service of a DDS topic, or None if it does not belong to a service."""
    for start, end in (("rq/", "Request"), ("rr/", "Reply")):
        if topic.startswith(start) and topic.endswith(end):
            return topic[2 : -len(end)]
    return None


class IdlTypes:
    """The wheel's type classes for the message types of one store, created on demand."""

    def __init__(self, store: TypeStore) -> None:
        self._store = store
        self._made: dict[tuple[str, bool], Any] = {}
        self._lock = threading.Lock()

    def __getitem__(self, type_name: str) -> Any:
        """Return the class of ``package/msg/Name``; TYP001 if the type is unknown."""
        with self._lock:
            return self._struct(self._store[type_name])

    def with_header(self, type_name: str) -> Any:
        """Return the class of a request or response, with the call header before its fields."""
        with self._lock:
            return self._struct(self._store[type_name], _HEADER)

    def _struct(self, message: MessageType, header: Mapping[str, Any] = _NO_HEADER) -> Any:
        key = message.name, bool(header)
        if (made := self._made.get(key)) is not None:
            return made
        fields = {field.name: self._field(field.type) for field in message.fields}
        name = dds_type_name(message.name)
        struct = make_idl_struct(
            name.rpartition("::")[2],
            name.replace("::", "."),
            {**header, **(fields or {_PLACEHOLDER: idl_types.uint8})},
        )
        struct.__idl_annotations__["extensibility"] = "final"
        self._made[key] = struct
        return struct

    def _field(self, kind: FieldType) -> Any:
        if isinstance(kind, PrimitiveType):
            return _PRIMITIVES[kind.name]
        if isinstance(kind, StringType):
            return str if kind.bound is None else idl_types.bounded_str[kind.bound]
        if isinstance(kind, NamedType):
            return self._struct(self._store[kind.name])
        element = self._field(kind.element)
        if isinstance(kind, ArrayType):
            return idl_types.array[element, kind.length]
        return idl_types.sequence[element if kind.bound is None else (element, kind.bound)]
