"""Converting messages between definitions: every type that is bundled, both serializations, and damage."""

from __future__ import annotations

import struct
from typing import Any

import pytest

from rosplc.codec import Codec, Wire
from rosplc.errors import CodecError
from rosplc.layout import Limits, compute_layout
from rosplc.layout.layout import Layout
from rosplc.model import TypeStore
from rosplc.model.types import (
    ArrayType,
    FieldType,
    MessageType,
    NamedType,
    PrimitiveType,
    StringType,
)
from rosplc.recorder.convert import Conversion

JAZZY, NOETIC = TypeStore.bundled("jazzy"), TypeStore.bundled("noetic")


def reversed_store(store: TypeStore) -> TypeStore:
    """Return the same types, each with its fields in the opposite order."""
    types = {name: store[name] for name in store.names()}
    return TypeStore(
        store.distro,
        {name: MessageType(name, one.fields[::-1], one.constants) for name, one in types.items()},
    )


def filled(store: TypeStore, kind: FieldType, number: list[int]) -> Any:
    """Return a value of a type in which every number and text is another."""
    number[0] = (number[0] + 1) % 100
    if isinstance(kind, NamedType):
        return {field.name: filled(store, field.type, number) for field in store[kind.name].fields}
    if isinstance(kind, StringType):
        return "x" * (number[0] % 5)
    if isinstance(kind, PrimitiveType):
        return bool(number[0] % 2) if kind.name == "bool" else number[0]
    length = kind.length if isinstance(kind, ArrayType) else min(number[0] % 3, kind.bound or 3)
    return [filled(store, kind.element, number) for _ in range(length)]


def layout_for(store: TypeStore, name: str) -> Layout:
    return compute_layout(store, name, Limits(8, 3))


@pytest.mark.parametrize(
    ("store", "source_wire", "target_wire"),
    [
        (JAZZY, Wire.CDR, Wire.CDR),
        (JAZZY, Wire.CDR, Wire.ROS1),
        (NOETIC, Wire.ROS1, Wire.CDR),
        (NOETIC, Wire.ROS1, Wire.ROS1),
    ],
)
@pytest.mark.parametrize("turned", [True, False])
def test_every_type_keeps_its_values(
    store: TypeStore, source_wire: Wire, target_wire: Wire, turned: bool
) -> None:
    """Whatever order its fields are recorded in, each has its value after conversion, and byte by byte."""
    source = reversed_store(store) if turned else store
    for name in store.names():
        value = filled(store, NamedType(name), [len(name)])
        given = layout_for(source, name)
        wanted = Codec(layout_for(store, name), target_wire)
        data = Codec(given, source_wire).encode(given.pack(value))
        conversion = Conversion(
            source,
            name,
            store,
            name,
            from_ros1=source_wire is Wire.ROS1,
            to_ros1=target_wire is Wire.ROS1,
        )
        assert conversion(data) == wanted.encode(wanted.layout.pack(value)), name
        if source_wire is Wire.CDR:
            assert conversion.unchanged is (conversion(data) is data)


def test_a_big_endian_message_comes_out_the_same() -> None:
    """The other byte order of CDR is read as well."""
    source = TypeStore.from_definition("a/msg/A", "uint16 a\nfloat64[] b\nstring c\n")
    target = TypeStore.from_definition("a/msg/A", "string c\nuint16 a\nfloat64[] b\n")
    head = struct.pack(">HxxI2dI", 258, 2, 1.5, 2.5, 3) + b"xy\0"
    codec = Codec(compute_layout(target, "a/msg/A"), Wire.CDR)
    data = Conversion(source, "a/msg/A", target, "a/msg/A")(b"\0\0\0\0" + head)
    assert codec.layout.to_dict(codec.decode(data)) == {"a": 258, "b": [1.5, 2.5], "c": "xy"}


@pytest.mark.parametrize(
    ("data", "code"),
    [
        (b"", "COD001"),
        (b"\0\1\0\0\1", "COD001"),
        (b"\0\7\0\0\1\0\0\0", "COD003"),
        (b"\0\1\0\0\xff\xff\xff\xff\0\0\0\0", "COD001"),
        (b"\0\1\0\0\0\0\0\0\0\0\0\0\0\0\0\0", "COD002"),
        (b"\0\1\0\0\3\0\0\0\1\2\3\0\0\0\0\0", "COD008"),
    ],
)
def test_damaged_messages(data: bytes, code: str) -> None:
    """A message that does not fit its definition, or the wanted one, is an error and never a wrong value."""
    source = TypeStore.from_definition("a/msg/A", "uint8[] a\nuint32 b\n")
    target = TypeStore.from_definition("a/msg/A", "uint32 b\nuint8[<=2] a\n")
    with pytest.raises(CodecError) as caught:
        Conversion(source, "a/msg/A", target, "a/msg/A")(data)
    assert caught.value.code == code


def test_what_one_side_lacks_is_noted() -> None:
    """Fields that only one side has are dropped or zero, and named."""
    conversion = Conversion(NOETIC, "std_msgs/msg/Header", JAZZY, "std_msgs/msg/Header", from_ros1=True)
    assert conversion.notes == ["seq is dropped: std_msgs/msg/Header has no such field"]
    back = Conversion(JAZZY, "std_msgs/msg/Header", NOETIC, "std_msgs/msg/Header", to_ros1=True)
    assert back.notes == ["seq stays zero: std_msgs/msg/Header has no such field"]
    data = struct.pack("<IIII", 9, 1, 2, 1) + b"w"
    assert back(conversion(data)) == bytes(4) + data[4:]
