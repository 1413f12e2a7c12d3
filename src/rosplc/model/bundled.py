"""The types that come with a ROS distribution: rosbags' own, with default values, and a desktop's.

rosbags' stores leave default values out. These were collected from every ``.msg`` file of the bundled
packages on the distributions' branches (ros2/common_interfaces, rcl_interfaces, geometry2, rosbag2,
rmw_dds_common, unique_identifier_msgs: humble, jazzy, rolling); those of kilted were compared with the
descriptions that rosidl generates (the micro-ROS libraries of hpmicro/hpm_sdk). ROS 1 has no default
values: a Quaternion's ``w`` starts as 0 there.

Of a desktop installation, ``example_interfaces`` repeats ``std_msgs``. The other packages were read from
their repositories, and a test compares their ROS 1 checksums; those with services or actions only are left
out.
"""

from __future__ import annotations

from dataclasses import replace
from importlib.resources import files

from rosplc.model._rosbags import bundled_types, parse_field_type
from rosplc.model.parse import parse_definition
from rosplc.model.types import FieldType, MessageType, Value

_EVERY_ROS2: dict[str, dict[str, Value]] = {
    "geometry_msgs/msg/Quaternion": {"x": 0.0, "y": 0.0, "z": 0.0, "w": 1.0},
    "rcl_interfaces/msg/ParameterDescriptor": {"read_only": False, "dynamic_typing": False},
}
_SINCE_JAZZY: dict[str, dict[str, Value]] = {
    **_EVERY_ROS2,
    "sensor_msgs/msg/NavSatStatus": {"status": -2},
    "type_description_interfaces/msg/FieldType": {"type_id": 0},
}

_TURTLE = {
    "Color": "uint8 r\nuint8 g\nuint8 b\n",
    "Pose": "float32 x\nfloat32 y\nfloat32 theta\nfloat32 linear_velocity\nfloat32 angular_velocity\n",
}
_EVERYWHERE = {
    "map_msgs": {
        "OccupancyGridUpdate": (
            "std_msgs/Header header\nint32 x\nint32 y\nuint32 width\nuint32 height\nint8[] data\n"
        ),
        "PointCloud2Update": (
            "uint32 ADD=0\nuint32 DELETE=1\nstd_msgs/Header header\nuint32 type\n"
            "sensor_msgs/PointCloud2 points\n"
        ),
        "ProjectedMap": "nav_msgs/OccupancyGrid map\nfloat64 min_z\nfloat64 max_z\n",
        "ProjectedMapInfo": (
            "string frame_id\nfloat64 x\nfloat64 y\nfloat64 width\nfloat64 height\n"
            "float64 min_z\nfloat64 max_z\n"
        ),
    },
    "pcl_msgs": {
        "ModelCoefficients": "std_msgs/Header header\nfloat32[] values\n",
        "PointIndices": "std_msgs/Header header\nint32[] indices\n",
        "PolygonMesh": "std_msgs/Header header\nsensor_msgs/PointCloud2 cloud\nVertices[] polygons\n",
        "Vertices": "uint32[] vertices\n",
    },
    "turtlesim": _TURTLE,
}
_ROS1 = {
    "tf": {"tfMessage": "geometry_msgs/TransformStamped[] transforms\n"},
    "tf2_msgs": {
        "TFMessage": "geometry_msgs/TransformStamped[] transforms\n",
        "TF2Error": (
            "uint8 NO_ERROR=0\nuint8 LOOKUP_ERROR=1\nuint8 CONNECTIVITY_ERROR=2\n"
            "uint8 EXTRAPOLATION_ERROR=3\n"
            "uint8 INVALID_ARGUMENT_ERROR=4\nuint8 TIMEOUT_ERROR=5\nuint8 TRANSFORM_ERROR=6\n"
            "uint8 error\nstring error_string\n"
        ),
    },
}
_ROS2 = {
    "pendulum_msgs": {
        "JointCommand": "float64 position\n",
        "JointState": "float64 position\nfloat64 velocity\nfloat64 effort\n",
        "RttestResults": (
            "builtin_interfaces/Time stamp\nJointCommand command\nJointState state\nuint64 cur_latency\n"
            "float64 mean_latency\nuint64 min_latency\nuint64 max_latency\nuint64 minor_pagefaults\n"
            "uint64 major_pagefaults\n"
        ),
    },
    "turtlesim_msgs": _TURTLE,
}
_NOT_REPEATED = ("Header", "ColorRGBA")


def bundled(distro: str) -> dict[str, MessageType]:
    """Return every type of a distribution, with default values."""
    types = bundled_types(distro)
    if distro == "noetic":
        return _parsed(1, _EVERYWHERE, _ROS1) | types
    types = with_defaults(types, _EVERY_ROS2 if distro == "humble" else _SINCE_JAZZY)
    return _examples(types) | _parsed(2, _EVERYWHERE, _ROS2) | types


def bundled_interfaces(distro: str) -> dict[str, tuple[str]]:
    """Return the text of every service and action of a distribution by its full name."""
    found: dict[str, tuple[str]] = {}
    for section in files("rosplc.model").joinpath("interfaces.txt").read_text().split("\n==== ")[1:]:
        head, _, text = section.partition("\n")
        name, *distros = head.split()
        if distro in distros:
            found[name] = (text,)
    return found


def with_defaults(
    types: dict[str, MessageType], defaults: dict[str, dict[str, Value]]
) -> dict[str, MessageType]:
    """Return ``types`` with default values.

    Raises:
        LookupError: The table names a type or a field that the distribution lacks.
    """
    result = dict(types)
    for name, values in defaults.items():
        message = result[name]
        if missing := values.keys() - {field.name for field in message.fields}:
            raise LookupError(f"{name} has no field {sorted(missing)}")
        result[name] = replace(
            message, fields=tuple(replace(f, default=values.get(f.name)) for f in message.fields)
        )
    return result


def _parsed(ros_version: int, *packages: dict[str, dict[str, str]]) -> dict[str, MessageType]:
    found = (
        parse_definition(f"{package}/{name}", text, ros_version=ros_version)[0].message
        for each in packages
        for package, texts in each.items()
        for name, text in texts.items()
    )
    return {message.name: message for message in found}


def _examples(types: dict[str, MessageType]) -> dict[str, MessageType]:
    """Return the types of std_msgs as those of example_interfaces."""

    def own(text: str) -> str:
        return text.replace("std_msgs/", "example_interfaces/")

    def own_type(kind: FieldType) -> FieldType:
        parsed = parse_field_type(own(str(kind)), "")
        assert parsed is not None
        return parsed[0]

    return {
        own(name): MessageType(
            own(name), tuple(replace(f, type=own_type(f.type)) for f in message.fields), message.constants
        )
        for name, message in types.items()
        if name.startswith("std_msgs/") and not name.endswith(_NOT_REPEATED)
    }
