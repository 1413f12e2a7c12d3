"""Default values of bundled types, which rosbags' stores leave out.

Collected from every ``.msg`` file of the bundled packages on the distributions' branches:

* ros2/common_interfaces (humble, jazzy, rolling): geometry_msgs/msg/Quaternion.msg,
  and, from jazzy on, sensor_msgs/msg/NavSatStatus.msg.
* ros2/rcl_interfaces (humble, jazzy, rolling): rcl_interfaces/msg/ParameterDescriptor.msg and,
  from jazzy on, type_description_interfaces/msg/FieldType.msg.
* ros2/geometry2, rosbag2, rmw_dds_common, unique_identifier_msgs: none.

Those of kilted were compared with the descriptions that rosidl generates (the micro-ROS
libraries of hpmicro/hpm_sdk): the same four types have defaults there, and no other bundled one.
ROS 1 has no default values: a Quaternion's ``w`` starts as 0 there.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

if TYPE_CHECKING:
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
_BY_DISTRO: dict[str, dict[str, dict[str, Value]]] = {
    "humble": _EVERY_ROS2,
    "jazzy": _SINCE_JAZZY,
    "kilted": _SINCE_JAZZY,
    "lyrical": _SINCE_JAZZY,
    "noetic": {},
}


def with_defaults(distro: str, types: dict[str, MessageType]) -> dict[str, MessageType]:
    """Return ``types`` with the default values that the distribution's packages have.

    Raises:
        LookupError: The table names a type or a field that the distribution lacks.
    """
    result = dict(types)
    for name, defaults in _BY_DISTRO[distro].items():
        message = result[name]
        if missing := defaults.keys() - {field.name for field in message.fields}:
            raise LookupError(f"{name} has no field {sorted(missing)}")
        fields = tuple(replace(f, default=defaults.get(f.name)) for f in message.fields)
        result[name] = replace(message, fields=fields)
    return result
