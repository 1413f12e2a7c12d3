"""Messages that the node itself reads and writes, compared with rosbags' serialization."""

from __future__ import annotations

import contextlib
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from rosbags.typesys import Stores, get_typestore

from rosplc.errors import BackendError
from rosplc.model import TypeStore
from rosplc.ros import fields

STORE = TypeStore.bundled("jazzy")
EVENT = "rcl_interfaces/msg/ParameterEvent"
VALUE = {
    "type": 9,
    "bool_value": True,
    "integer_value": -(2**62),
    "double_value": 0.5,
    "string_value": "größer",
    "byte_array_value": b"\0\xff",
    "bool_array_value": [True, False],
    "integer_array_value": [-1, 2**62],
    "double_array_value": [0.25],
    "string_array_value": ["", "two"],
}
MESSAGE = {
    "stamp": {"sec": -5, "nanosec": 6},
    "node": "/cell",
    "new_parameters": [{"name": "a", "value": VALUE}, {"name": "b", "value": VALUE}],
    "changed_parameters": [],
    "deleted_parameters": [],
}
ARRAYS = {"byte": np.uint8, "bool": np.bool_, "integer": np.int64, "double": np.float64}


def oracle_message(kinds: Any) -> Any:
    """Return the same message as rosbags has it."""
    arrays = {f"{name}_array_value": kind for name, kind in ARRAYS.items()}
    parameter, value = kinds["rcl_interfaces/msg/Parameter"], kinds["rcl_interfaces/msg/ParameterValue"]

    def made(name: str) -> Any:
        given = {**VALUE, "byte_array_value": [0, 255]}
        return parameter(
            name, value(**{k: np.array(v, arrays[k]) if k in arrays else v for k, v in given.items()})
        )

    stamp = kinds["builtin_interfaces/msg/Time"](-5, 6)
    return kinds[EVENT](stamp, "/cell", [made("a"), made("b")], [], [])


@pytest.mark.parametrize("little", [True, False])
def test_a_message_is_read_and_written_as_elsewhere(little: bool) -> None:
    """Both byte orders are read, little-endian is written; what is cut off is refused."""
    oracle = get_typestore(Stores.ROS2_JAZZY)
    message = oracle_message(oracle.types)
    data = bytes(oracle.serialize_cdr(message, EVENT, little_endian=little))
    assert fields.unpack(STORE, EVENT, data) == MESSAGE
    packed = fields.pack(STORE, EVENT, MESSAGE)
    assert packed == bytes(oracle.serialize_cdr(message, EVENT))[: len(packed)]
    for size in range(len(packed)):
        with pytest.raises(BackendError, match="ROS008"):
            fields.unpack(STORE, EVENT, data[:size])


def test_ros1_has_no_padding() -> None:
    """A store of ROS 1's types writes and reads as ROS 1 does, a message's begin too."""
    store, name = TypeStore.bundled("noetic"), "diagnostic_msgs/msg/DiagnosticStatus"
    values = {"level": 1, "name": "abc", "values": [{"key": "k", "value": ""}]}
    expected = b"\1\3\0\0\0abc" + bytes(8) + b"\1\0\0\0" + b"\1\0\0\0k" + bytes(4)
    assert fields.pack(store, name, values) == expected
    assert fields.unpack(store, name, expected) == {"message": "", "hardware_id": "", **values}
    assert fields.unpack_first(store, name, expected, 2) == ({"level": 1, "name": "abc"}, expected[8:])
    with pytest.raises(BackendError, match="ROS008"):
        fields.unpack(store, name, expected[:-1])


def test_what_is_not_given_is_zero_or_empty() -> None:
    """An empty mapping makes a whole message."""
    found = fields.unpack(STORE, EVENT, fields.pack(STORE, EVENT, {}))
    assert found["stamp"] == {"sec": 0, "nanosec": 0}
    assert (found["node"], found["new_parameters"]) == ("", [])


@given(st.binary(max_size=200))
def test_any_bytes_are_a_message_or_refused(data: bytes) -> None:
    """Nothing that a peer sends raises another error."""
    with contextlib.suppress(BackendError):
        fields.unpack(STORE, EVENT, b"\0\1\0\0" + data)


def test_text_that_is_no_utf8_is_kept() -> None:
    """What was read is written with the same bytes."""
    data = b"\0\1\0\0\3\0\0\0\xff\xfe\0"
    assert (
        fields.pack(STORE, "std_msgs/msg/String", fields.unpack(STORE, "std_msgs/msg/String", data)) == data
    )
