"""Every bundled type, value by value, against rosbags' own serialization."""

from __future__ import annotations

import random
from functools import cache
from typing import Any

import numpy as np
import pytest
from rosbags.interfaces import Nodetype
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from rosplc.codec import Codec, Wire
from rosplc.layout import Limits, compute_layout
from rosplc.model import DISTROS, TypeStore
from tests.codec_oracle import Oracle, random_value
from tests.codec_types import HARD_TYPES, hard_store

pytestmark = pytest.mark.verifies("conversion", real="rosbags")

STORES = {
    "humble": Stores.ROS2_HUMBLE,
    "jazzy": Stores.ROS2_JAZZY,
    "kilted": Stores.ROS2_KILTED,
    "lyrical": Stores.ROS2_LYRICAL,
    "noetic": Stores.ROS1_NOETIC,
}
DUMMY = "structure_needs_at_least_one_member"
DTYPES = {"byte": "uint8", "char": "uint8"}


@cache
def rosbags_store(distro: str) -> Any:
    store = get_typestore(STORES[distro])
    for name, text in HARD_TYPES.items():
        store.register(get_types_from_msg(text, name))
    return store


@cache
def own_store(distro: str) -> TypeStore:
    return hard_store(distro)


def names(distro: str) -> list[str]:
    return [name for name in own_store(distro).names() if name in rosbags_store(distro).fielddefs]


def signed(byte: int) -> int:
    """For rosbags a byte is signed, for rosplc unsigned: the bits count."""
    return byte - 256 if byte > 127 else byte


def ros1(store: Any) -> bool:
    """Return whether a byte is signed on both sides, as ROS 1 has it."""
    return bool(store is rosbags_store("noetic"))


def to_rosbags(store: Any, name: str, value: dict[str, Any]) -> Any:
    def convert(node: Any, item: Any) -> Any:
        kind, argument = node
        if kind == Nodetype.BASE:
            return signed(item) if argument[0] == "byte" and not ros1(store) else item
        if kind == Nodetype.NAME:
            return to_rosbags(store, argument, item)
        element = argument[0]
        if element == (Nodetype.BASE, ("byte", 0)) and ros1(store):
            return np.array(item, dtype="int8").view("uint8")
        if element[0] == Nodetype.BASE and element[1][0] != "string":
            return np.array(item, dtype=DTYPES.get(element[1][0], element[1][0]))
        return [convert(element, each) for each in item]

    fields = store.fielddefs[name][1]
    return store.types[name](**{field: convert(node, value.get(field, 0)) for field, node in fields})


def to_plain(store: Any, name: str, message: Any) -> dict[str, Any]:
    def convert(node: Any, item: Any) -> Any:
        kind, argument = node
        if kind == Nodetype.NAME:
            return to_plain(store, argument, item)
        if kind == Nodetype.BASE:
            return item % 256 if argument[0] == "byte" and not ros1(store) else item
        if isinstance(item, np.ndarray):
            if argument[0][1][0] != "byte":
                return item.tolist()
            return item.astype("int8" if ros1(store) else "uint8").tolist()
        return [convert(argument[0], each) for each in item]

    fields = store.fielddefs[name][1]
    return {field: convert(node, getattr(message, field)) for field, node in fields if field != DUMMY}


def check(distro: str, name: str, seed: int) -> None:
    """Rosbags' bytes decode to the right record, and our bytes are what rosbags reads back."""
    rosbags = rosbags_store(distro)
    oracle = Oracle(own_store(distro), 9, 3)
    wire = Wire.ROS1 if distro == "noetic" else Wire.CDR
    codec = Codec(compute_layout(oracle.store, name, Limits(9, 3)), wire)
    value = random_value(oracle, name, random.Random(f"{name} {seed}"))
    record = oracle.record(name, value)
    message = to_rosbags(rosbags, name, value)
    if wire is Wire.ROS1:
        assert codec.decode(rosbags.serialize_ros1(message, name)) == record
        back = rosbags.deserialize_ros1(codec.encode(record), name)
    else:
        for little in (True, False):
            assert codec.decode(rosbags.serialize_cdr(message, name, little_endian=little)) == record
        back = rosbags.deserialize_cdr(codec.encode(record), name)
    assert oracle.record(name, to_plain(rosbags, name, back)) == record


@pytest.mark.parametrize("distro", DISTROS)
def test_rosbags_and_the_codec_agree(distro: str) -> None:
    """Messages that rosbags writes decode to their values, and rosbags reads what the codec writes."""
    for name in names(distro):
        for seed in range(2):
            check(distro, name, seed)


@pytest.mark.verify(minutes=0.75)
@pytest.mark.timeout(900)
@pytest.mark.parametrize("distro", DISTROS)
def test_rosbags_and_the_codec_agree_often(distro: str) -> None:
    """The same with many contents per type."""
    for name in names(distro):
        for seed in range(40):
            check(distro, name, seed)
