"""The demonstration's messages: built with a number and a seal, checked on arrival.

A stamped message carries both in ``header.frame_id`` (``"odom 17 1a2b3c4d"``). A Twist has
no text field, so the command's number travels in ``linear.z`` and its seal in
``angular.x``; a robot on wheels has no use for either.
"""

from __future__ import annotations

import zlib
from array import array
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import Any

__all__ = ["COMMAND", "KINDS", "Kind", "Opened", "command", "open_command", "robot_topics"]

SECOND_NS = 1_000_000_000

_JOINTS = tuple(f"wheel_{side}_{end}" for end in ("front", "rear") for side in ("left", "right"))
_BEAMS = 64


@dataclass(frozen=True, slots=True)
class Opened:
    """What a received message says about itself.

    Attributes:
        number: Its number in the sender's count, from 1; 0 if the seal is broken.
        whole: Whether seal and contents agree.
        stamp_ns: When the sender made it, ns since 1970; 0 where it carries none.
    """

    number: int
    whole: bool
    stamp_ns: int = 0


@dataclass(frozen=True, slots=True)
class Kind:
    """A kind of message that the robot sends.

    Attributes:
        name: Its topic's last part.
        type_name: ``package/msg/Name``.
        frame: The frame in ``header.frame_id``.
        numbers: Every number of a message (a dict or a record view), as ``float64`` values.
    """

    name: str
    type_name: str
    frame: str
    numbers: Callable[[Any], Iterable[float]]

    def seal(self, value: dict[str, Any], number: int, stamp_ns: int) -> dict[str, Any]:
        """Return ``value`` with a header that numbers, dates and seals it."""
        crc = _crc(number, stamp_ns, self.numbers(_Dotted(value)))
        value["header"] = {
            "stamp": {"sec": stamp_ns // SECOND_NS, "nanosec": stamp_ns % SECOND_NS},
            "frame_id": f"{self.frame} {number} {crc:08x}",
        }
        return value

    def open(self, message: Any) -> Opened:
        """Check a received message (attribute access, as a record view gives it)."""
        stamp = message.header.stamp
        stamp_ns = stamp.sec * SECOND_NS + stamp.nanosec
        try:
            frame, number, crc = message.header.frame_id.split(" ")
            whole = frame == self.frame and int(crc, 16) == _crc(int(number), stamp_ns, self.numbers(message))
        except ValueError:
            return Opened(0, False)
        return Opened(int(number) if whole else 0, whole, stamp_ns)


class _Dotted:
    """Attribute access to nested dicts, so that one function reads dicts and views."""

    def __init__(self, value: dict[str, Any]) -> None:
        self._value = value

    def __getattr__(self, name: str) -> Any:
        value = self._value[name]
        return _Dotted(value) if isinstance(value, dict) else value


def _crc(number: int, stamp_ns: int, numbers: Iterable[float]) -> int:
    head = number.to_bytes(4, "little") + stamp_ns.to_bytes(8, "little")
    return zlib.crc32(array("d", numbers).tobytes(), zlib.crc32(head))


def _pose_numbers(message: Any) -> list[float]:
    p, q = message.pose.position, message.pose.orientation
    return [p.x, p.y, p.z, q.x, q.y, q.z, q.w]


def _joint_numbers(message: Any) -> list[float]:
    return [*message.position, *message.velocity, *message.effort]


def _scan_numbers(message: Any) -> list[float]:
    return [message.angle_min, message.angle_max, message.range_max, *message.ranges]


_POSE = Kind("pose", "geometry_msgs/msg/PoseStamped", "odom", _pose_numbers)
_JOINT = Kind("joint_states", "sensor_msgs/msg/JointState", "base", _joint_numbers)
_SCAN = Kind("scan", "sensor_msgs/msg/LaserScan", "laser", _scan_numbers)

KINDS: dict[str, Kind] = {kind.name: kind for kind in (_POSE, _JOINT, _SCAN)}
"""What the robot can send, by name."""

COMMAND = ("/turtle/cmd_vel", "geometry_msgs/msg/Twist")
"""Topic and type of what the PLC sends back."""


def robot_topics(count: int) -> dict[str, Kind]:
    """Return the robot's first ``count`` topics: pose, joint states, then laser scans."""
    topics = {"/turtle/pose": _POSE, "/turtle/joint_states": _JOINT, "/turtle/scan": _SCAN}
    for number in range(4, count + 1):
        topics[f"/turtle/scan_{number}"] = _SCAN
    return dict(list(topics.items())[:count])


def command(number: int, forward: float, turn: float) -> dict[str, Any]:
    """Return a Twist that drives ``forward`` (m/s) and turns (rad/s), numbered and sealed."""
    seal = float(_crc(number, 0, [forward, turn]))
    return {
        "linear": {"x": forward, "y": 0.0, "z": float(number)},
        "angular": {"x": seal, "y": 0.0, "z": turn},
    }


def open_command(message: Any) -> Opened:
    """Check a received command."""
    linear, angular = message.linear, message.angular
    if not (linear.z.is_integer() and 0 < linear.z < 2**32):
        return Opened(0, False)
    number = int(linear.z)
    whole = linear.y == angular.y == 0.0 and angular.x == _crc(number, 0, [linear.x, angular.z])
    return Opened(number if whole else 0, whole)


def joint_state(angles: Sequence[float], speed: float) -> dict[str, Any]:
    """Return the contents of a JointState: four wheels at ``angles`` (rad), ``speed`` (rad/s)."""
    return {
        "name": list(_JOINTS),
        "position": list(angles),
        "velocity": [speed] * len(_JOINTS),
        "effort": [0.1 * angle for angle in angles],
    }


def laser_scan(distances: Sequence[float]) -> dict[str, Any]:
    """Return the contents of a LaserScan; values are rounded to the type's ``float32``."""
    low, high, far, *ranges = array("f", [-3.14159, 3.14159, 30.0, *distances])
    return {"angle_min": low, "angle_max": high, "range_max": far, "ranges": ranges}


BEAMS = _BEAMS
JOINTS = len(_JOINTS)
