"""Message types of a desktop installation of ROS that rosbags does not bundle.

``example_interfaces`` repeats ``std_msgs``. The others were read from the packages' repositories, and
a test compares their ROS 1 checksums. Packages with services or actions only have no place here.
"""

from __future__ import annotations

from dataclasses import replace

from rosplc.model.parse import parse_definition
from rosplc.model.types import ArrayType, Field, MessageType, NamedType, SequenceType

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


def with_desktop(distro: str, types: dict[str, MessageType]) -> dict[str, MessageType]:
    """Return ``types`` with those of a desktop installation; what is in ``types`` stays."""
    ros_version = 1 if distro == "noetic" else 2
    result = {} if ros_version == 1 else _repeated(types, "std_msgs/", "example_interfaces/")
    for packages in (_EVERYWHERE, _ROS1 if ros_version == 1 else _ROS2):
        for package, texts in packages.items():
            for name, text in texts.items():
                (parsed,) = parse_definition(f"{package}/{name}", text, ros_version=ros_version)
                result[parsed.message.name] = parsed.message
    return result | types


def _repeated(types: dict[str, MessageType], source: str, target: str) -> dict[str, MessageType]:
    """Return one package's types as another's."""

    def renamed(field: Field) -> Field:
        kind = field.type
        element = kind.element if isinstance(kind, ArrayType | SequenceType) else kind
        if not isinstance(element, NamedType):
            return field
        own = NamedType(element.name.replace(source, target))
        return replace(
            field, type=replace(kind, element=own) if isinstance(kind, ArrayType | SequenceType) else own
        )

    return {
        name.replace(source, target): replace(
            message, name=name.replace(source, target), fields=tuple(map(renamed, message.fields))
        )
        for name, message in types.items()
        if name.startswith(source) and not name.endswith(_NOT_REPEATED)
    }
