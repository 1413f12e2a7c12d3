"""How long strings and sequences are, measured on the wire bytes."""

from __future__ import annotations

import random
from collections.abc import Iterator
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from rosplc.init.found import Meter
from rosplc.model import ArrayType, FieldType, NamedType, SequenceType, StringType, TypeStore
from tests.codec_oracle import Oracle, random_value
from tests.codec_types import HARD_TYPES, hard_store

STORE = hard_store("jazzy")
NOETIC = hard_store("noetic")
TREE = "hard_msgs/msg/Tree"


def lengths(store: TypeStore, kind: FieldType, value: Any, path: str) -> Iterator[tuple[str, int]]:
    """Yield path and length of every string and sequence of a value: what the meter must find."""
    if isinstance(kind, StringType):
        yield path, len(value.encode())
    elif isinstance(kind, NamedType):
        for field in store[kind.name].fields:
            inner = f"{path}.{field.name}" if path else field.name
            yield from lengths(store, field.type, value[field.name], inner)
    elif isinstance(kind, ArrayType | SequenceType):
        if isinstance(kind, SequenceType):
            yield path, len(value)
        for item in value:
            yield from lengths(store, kind.element, item, f"{path}[]")


@settings(deadline=None, max_examples=60)
@given(
    name=st.sampled_from([*HARD_TYPES, "sensor_msgs/msg/JointState", "visualization_msgs/msg/Marker"]),
    seed=st.integers(0, 1 << 32),
)
def test_every_length_is_found_on_every_wire(name: str, seed: int) -> None:
    """Least and most of each field are those of the values, in CDR of both byte orders and in ROS 1."""
    for store, version in ((STORE, 2), (NOETIC, 1)):
        oracle = Oracle(store, 20, 3)
        value = random_value(oracle, name, random.Random(seed))
        wanted: dict[str, set[int]] = {}
        for path, length in lengths(store, NamedType(name), value, ""):
            wanted.setdefault(path, set()).add(length)
        wires = [oracle.ros1(name, value)]
        if version == 2:
            wires = [oracle.cdr(name, value), oracle.cdr(name, value, little=False)]
        for wire in wires:
            meter = Meter(store, name)
            meter.take(wire, 1)
            assert (meter.seen.messages, meter.seen.unreadable) == (1, 0)
            found = {path: (length.least, length.most) for path, length in meter.seen.lengths.items()}
            assert found == {path: (min(seen), max(seen)) for path, seen in wanted.items()}


def test_messages_add_up() -> None:
    """The shortest and the longest of all messages are kept."""
    oracle = Oracle(STORE)
    meter = Meter(STORE, "std_msgs/msg/String")
    for text in ("four", "", "seven!!"):
        meter.take(oracle.cdr("std_msgs/msg/String", {"data": text}), 1)
    assert meter.seen.messages == 3
    assert (meter.seen.lengths["data"].least, meter.seen.lengths["data"].most) == (0, 7)


@settings(deadline=None, max_examples=200)
@given(data=st.binary(max_size=200))
def test_any_bytes_are_survived(data: bytes) -> None:
    """Bytes that are no message are counted as such, or measured; nothing else happens."""
    meter = Meter(STORE, TREE)
    meter.take(b"\0\1\0\0" + data, 1)
    meter.take(data, 2)
    assert meter.seen.messages + meter.seen.unreadable == 2


@pytest.mark.parametrize(
    "wire",
    [
        pytest.param(b"", id="nothing"),
        pytest.param(b"\0\3\0\0\1\0\0\0a", id="another encapsulation"),
        pytest.param(b"\0\1\0\0\xff\xff\xff\xff", id="4 GiB announced"),
        pytest.param(b"\0\1\0\0\5\0\0\0ab", id="cut off"),
    ],
)
def test_message_that_does_not_fit_is_counted(wire: bytes) -> None:
    """What cannot be a message of the type adds to no length."""
    meter = Meter(STORE, "std_msgs/msg/String")
    meter.take(wire, 1)
    assert (meter.seen.messages, meter.seen.unreadable, meter.seen.lengths) == (0, 1, {})


def test_work_for_one_message_is_bounded() -> None:
    """A sequence that claims four thousand million empty elements is left after a while."""
    store = TypeStore.bundled("noetic").with_definition(
        "t_msgs/msg/M", "std_msgs/Empty[] items\nstring end\n"
    )
    meter = Meter(store, "t_msgs/msg/M")
    meter.take(b"\xff\xff\xff\xff\0\0\0\0", 1)
    assert (meter.seen.messages, meter.seen.unreadable) == (1, 0)
    assert meter.seen.lengths["items"].most == 0xFFFFFFFF
