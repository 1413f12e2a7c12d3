"""The types that come with a ROS distribution: rosbags' own, with default values, and a desktop's.

rosbags' stores leave default values out. These were collected from every ``.msg`` file of the bundled
packages on the distributions' branches (ros2/common_interfaces, rcl_interfaces, geometry2, rosbag2,
rmw_dds_common, unique_identifier_msgs: humble, jazzy, rolling); those of kilted were compared with the
descriptions that rosidl generates (the micro-ROS libraries of hpmicro/hpm_sdk). ROS 1 has no default
values: a Quaternion's ``w`` starts as 0 there.

The messages of a desktop installation that rosbags lacks are in ``interfaces.txt``, with all services and
actions; a test compares their ROS 1 checksums.
"""

from __future__ import annotations

from dataclasses import replace
from importlib.resources import files

from rosplc.model._rosbags import bundled_types
from rosplc.model.parse import parse_definition
from rosplc.model.types import MessageType, Value

_EVERY_ROS2: dict[str, dict[str, Value]] = {
    "geometry_msgs/msg/Quaternion": {"x": 0.0, "y": 0.0, "z": 0.0, "w": 1.0},
    "rcl_interfaces/msg/ParameterDescriptor": {"read_only": False, "dynamic_typing": False},
}
_SINCE_JAZZY: dict[str, dict[str, Value]] = {
    **_EVERY_ROS2,
    "sensor_msgs/msg/NavSatStatus": {"status": -2},
    "type_description_interfaces/msg/FieldType": {"type_id": 0},
}


def bundled(distro: str) -> tuple[dict[str, MessageType], dict[str, tuple[str]]]:
    """Return every message of a distribution, with default values, and the texts of services and actions."""
    types = bundled_types(distro)
    version = 1 if distro == "noetic" else 2
    if version == 2:
        types = with_defaults(types, _EVERY_ROS2 if distro == "humble" else _SINCE_JAZZY)
    own: dict[str, MessageType] = {}
    interfaces: dict[str, tuple[str]] = {}
    for section in files("rosplc.model").joinpath("interfaces.txt").read_text().split("\n==== ")[1:]:
        head, _, text = section.partition("\n")
        name, *distros = head.split()
        if distro not in distros:
            continue
        if "/msg/" in name:
            own[name] = parse_definition(name, text, ros_version=version)[0].message
        else:
            interfaces[name] = (text,)
    return own | types, interfaces


def with_defaults(
    types: dict[str, MessageType], defaults: dict[str, dict[str, Value]]
) -> dict[str, MessageType]:
    """Return ``types`` with default values; LookupError for a type or field that is missing."""
    result = dict(types)
    for name, values in defaults.items():
        message = result[name]
        if missing := values.keys() - {field.name for field in message.fields}:
            raise LookupError(f"{name} has no field {sorted(missing)}")
        result[name] = replace(
            message, fields=tuple(replace(f, default=values.get(f.name)) for f in message.fields)
        )
    return result
