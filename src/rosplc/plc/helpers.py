"""Functions and blocks that a technician expects beside the messages: times, angles, handshake."""

from __future__ import annotations

from rosplc.layout import compute_layout
from rosplc.model import TypeStore
from rosplc.plc.base import read_objects
from rosplc.plc.project import Item
from rosplc.plc.types import DutBuilder

__all__ = ["HELPER_NAMES", "helper_objects"]

# Message type that a helper uses → the helpers, each after those that it calls.
_TIMES = (
    "RosPlc_TimeToLtime", "RosPlc_LtimeToTime", "RosPlc_TimeToLdt", "RosPlc_LdtToTime",
)  # fmt: skip
_DURATIONS = ("RosPlc_DurationToTime", "RosPlc_TimeToDuration")
_ANGLES = (
    "RosPlc_YawPitchRoll", "RosPlc_Atan2", "RosPlc_QuaternionToYpr", "RosPlc_YprToQuaternion",
)  # fmt: skip
_GENERAL = ("RosPlc_Handshake", "RosPlc_HandshakeReply")
_HELPERS = {
    "builtin_interfaces/msg/Time": _TIMES,
    "builtin_interfaces/msg/Duration": _DURATIONS,
    "geometry_msgs/msg/Quaternion": _ANGLES,
}
HELPER_NAMES = (*_GENERAL, *_TIMES, *_DURATIONS, *_ANGLES)
"""Names that no generated object may take, whether or not the helper is part of a project."""


def helper_objects(store: TypeStore, builder: DutBuilder, folder: str) -> tuple[Item, ...]:
    """Return the helpers, and have the message types built that they use.

    Args:
        store: The types; a helper whose message type is missing is left out.
        builder: Builds the DUTs.
        folder: The helpers' folder in the PLC project.
    """
    names: list[str] = list(_GENERAL)
    for type_name, helpers in _HELPERS.items():
        if type_name in store:
            builder.add(compute_layout(store, type_name))
            names += helpers
    return read_objects("helpers", names, folder)
