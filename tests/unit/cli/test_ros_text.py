"""Messages as YAML and as Python's notation: what ``rosplc echo`` and ``rosplc pub`` print and read."""

from __future__ import annotations

import random
import time

import pytest
import yaml

from rosplc.cli.ros_text import Writer, as_python, as_yaml
from rosplc.errors import CodecError, LayoutError
from rosplc.model import TypeStore
from rosplc.ros.fields import unpack_whole
from tests.codec_oracle import Oracle, random_value

JAZZY, NOETIC = TypeStore.bundled("jazzy"), TypeStore.bundled("noetic")
ORACLE = Oracle(JAZZY, 12, 3)


@pytest.mark.parametrize("store", [JAZZY, NOETIC], ids=["CDR", "ROS 1"])
def test_yaml_that_is_published_is_what_is_echoed(store: TypeStore) -> None:
    """Fields that were not given have their defaults; lengths need no limits."""
    text = "{name: [elbow, ü], position: [1.5, -2.0, 3.25]}"
    value = unpack_whole(
        store,
        "sensor_msgs/msg/JointState",
        Writer(store, "sensor_msgs/msg/JointState", yaml.safe_load(text))(),
    )
    shown = yaml.safe_load(as_yaml(value))
    assert shown["name"] == ["elbow", "ü"]
    assert shown["position"] == [1.5, -2.0, 3.25]
    assert shown["velocity"] == []
    assert shown["header"]["frame_id"] == ""


@pytest.mark.parametrize(
    "name", ["sensor_msgs/msg/PointCloud2", "diagnostic_msgs/msg/DiagnosticArray", "std_msgs/msg/Empty"]
)
def test_random_messages_are_read_as_an_independent_codec_wrote_them(name: str) -> None:
    """Messages of growing and shrinking lengths."""
    dice = random.Random(1)
    for _ in range(20):
        data = ORACLE.cdr(name, random_value(ORACLE, name, dice))
        assert Writer(JAZZY, name, unpack_whole(JAZZY, name, data))() == data


@pytest.mark.parametrize("store", [JAZZY, NOETIC], ids=["CDR", "ROS 1"])
def test_present_time_stands_for_auto_and_now(store: TypeStore) -> None:
    """As in ``ros2 topic pub``."""
    before, name = time.time(), "geometry_msgs/msg/PoseStamped"
    for value in ({"header": "auto"}, {"header": {"stamp": "now"}}):
        stamp = unpack_whole(store, name, Writer(store, name, value)())["header"]["stamp"]
        assert before - 1 <= stamp["sec"] + stamp["nanosec"] / 1e9 <= time.time() + 1


def test_long_values_are_shortened_unless_asked_for() -> None:
    """An image fills no terminal."""
    value = {"data": list(range(1000)), "text": "a" * 1000}
    short = yaml.safe_load(as_yaml(value))
    assert len(short["data"]) == 129
    assert short["text"] == "a" * 128 + "..."
    assert yaml.safe_load(as_yaml(value, whole=True)) == value


@pytest.mark.parametrize(("value", "shown"), [({"data": "wait..."}, "data: wait..."), (0.5, "0.5")])
def test_only_the_mark_of_the_end_is_left_out(value: object, shown: str) -> None:
    """YAML ends a lone value with three dots; a text may do so as well."""
    assert as_yaml(value) == shown
    assert as_yaml({"data": "a" * 1000}).endswith("aaa...")


def test_python_notation() -> None:
    """As the generated classes' ``repr``; the tests with a real rclpy compare every type."""
    value = unpack_whole(
        JAZZY, "geometry_msgs/msg/Vector3", Writer(JAZZY, "geometry_msgs/msg/Vector3", {"x": 1})()
    )
    assert (
        as_python(JAZZY, "geometry_msgs/msg/Vector3", value)
        == "geometry_msgs.msg.Vector3(x=1.0, y=0.0, z=0.0)"
    )


def test_wrong_fields_and_bytes_are_named() -> None:
    """Neither ends in a traceback."""
    with pytest.raises(LayoutError, match="linar"):
        Writer(JAZZY, "geometry_msgs/msg/Twist", {"linar": {"x": 1}})()
    with pytest.raises(LayoutError):
        Writer(JAZZY, "geometry_msgs/msg/Twist", {"linear": {"x": "fast"}})()
    with pytest.raises(CodecError):
        unpack_whole(JAZZY, "geometry_msgs/msg/Twist", b"\0\1\0\0abc")


def test_nested_lengths_do_not_multiply() -> None:
    """One long inner and one long outer sequence of a small message cost no more than what they have."""
    level = {"level": 0, "name": "", "message": "", "hardware_id": ""}
    long = {**level, "values": [{"key": "", "value": ""}] * 3000}
    short = {**level, "values": []}
    header = {"stamp": {"sec": 0, "nanosec": 0}, "frame_id": ""}
    data = ORACLE.cdr(
        "diagnostic_msgs/msg/DiagnosticArray", {"header": header, "status": [long, *[short] * 3000]}
    )
    shown = unpack_whole(JAZZY, "diagnostic_msgs/msg/DiagnosticArray", data)
    assert shown["status"] == [long, *[short] * 3000]


def test_bytes_are_shown_as_numbers() -> None:
    """An image's data is a sequence of uint8, and no text in base64."""
    value = unpack_whole(JAZZY, "std_msgs/msg/UInt8MultiArray", b"\0\1\0\0" + bytes(8) + b"\2\0\0\0\x01\xff")
    assert yaml.safe_load(as_yaml(value, whole=True))["data"] == [1, 255]
