"""Write plans and messages to a file, for the programs in tests/fuzz/native.

usage: python -m tests.fuzz.export_plans FILE [SAMPLES]
"""

from __future__ import annotations

import random
import struct
import sys
from collections.abc import Iterable
from functools import cache
from pathlib import Path

from rosplc.codec import Wire, compile_plan
from rosplc.layout import Limits, compute_layout
from rosplc.model import DISTROS
from tests.codec_oracle import Oracle, random_value
from tests.codec_types import hard_store as make_store

__all__ = ["every_type", "export", "typical_types"]

TYPICAL = (
    "geometry_msgs/msg/PolygonStamped",
    "geometry_msgs/msg/PoseStamped",
    "nav_msgs/msg/OccupancyGrid",
    "nav_msgs/msg/Path",
    "sensor_msgs/msg/BatteryState",
    "sensor_msgs/msg/Imu",
    "sensor_msgs/msg/JointState",
    "sensor_msgs/msg/PointCloud2",
    "std_msgs/msg/Empty",
    "tf2_msgs/msg/TFMessage",  # ROS 2
    "tf/msg/tfMessage",  # ROS 1
    "trajectory_msgs/msg/JointTrajectory",
    "visualization_msgs/msg/MarkerArray",
)


hard_store = cache(make_store)


def typical_types() -> list[tuple[str, str]]:
    """Return distribution and name of the types that the driver runs: usual and hard ones."""
    found = []
    for distro in ("jazzy", "noetic"):
        store = hard_store(distro)
        hard = (name for name in store.names() if name.startswith("hard_msgs/"))
        found += [(distro, name) for name in (*(name for name in TYPICAL if name in store), *hard)]
    return found


def every_type() -> list[tuple[str, str]]:
    """Return distribution and name of every bundled type, and of the hard ones."""
    return [(distro, name) for distro in DISTROS for name in hard_store(distro).names()]


def export(
    path: Path, types: Iterable[tuple[str, str]], samples: int = 3, string: int = 6, sequence: int = 3
) -> list[list[bytes]]:
    """Write the plan and ``samples`` messages of each type; return the messages.

    ROS 1's types travel as ROS 1 sends them, ROS 2's as CDR.
    """
    parts, made = [], []
    for distro, name in types:
        store = hard_store(distro)
        oracle = Oracle(store, string, sequence)
        layout = compute_layout(store, name, Limits(string, sequence))
        wire = Wire.ROS1 if store.ros_version == 1 else Wire.CDR
        messages = []
        for number in range(samples):
            value = random_value(oracle, name, random.Random(f"{name} {number}"))
            if wire is Wire.ROS1:
                messages.append(oracle.ros1(name, value))
            else:
                messages.append(oracle.cdr(name, value, little=number % 2 == 0))
        blobs = b"".join(_sized(message) for message in messages)
        parts.append(_sized(compile_plan(layout.root, wire).blob) + struct.pack("<I", samples) + blobs)
        made.append(messages)
    path.write_bytes(struct.pack("<I", len(parts)) + b"".join(parts))
    return made


def _sized(data: bytes) -> bytes:
    return struct.pack("<I", len(data)) + data


if __name__ == "__main__":
    print(len(export(Path(sys.argv[1]), typical_types(), *(int(text) for text in sys.argv[2:3]))), "plans")
