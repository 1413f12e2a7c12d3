"""Write plans and messages to a file, for fuzz/plan_driver.c and fuzz/codec_fuzz.c.

usage: python fuzz/export_plans.py FILE [SAMPLES]
"""

from __future__ import annotations

import random
import struct
import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

from rosplc.codec import Wire, compile_plan
from rosplc.layout import Limits, compute_layout
from tests.codec_oracle import Oracle, random_value
from tests.codec_types import hard_store

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


def _sized(data: bytes) -> bytes:
    return struct.pack("<I", len(data)) + data


def export(path: Path, samples: int = 3, string: int = 6, sequence: int = 3) -> int:
    """Write ``samples`` messages of each typical and hard type per wire; return the number of plans."""
    parts = []
    for distro, wire in (("jazzy", Wire.CDR), ("noetic", Wire.ROS1)):
        store = hard_store(distro)
        oracle = Oracle(store, string, sequence)
        hard = (name for name in store.names() if name.startswith("hard_msgs/"))
        for name in (*(name for name in TYPICAL if name in store), *hard):
            layout = compute_layout(store, name, Limits(string, sequence))
            messages = []
            for number in range(samples):
                value = random_value(oracle, name, random.Random(f"{name} {number}"))
                if wire is Wire.ROS1:
                    messages.append(oracle.ros1(name, value))
                else:
                    messages.append(oracle.cdr(name, value, little=number % 2 == 0))
            blobs = b"".join(_sized(message) for message in messages)
            parts.append(_sized(compile_plan(layout.root, wire).blob) + struct.pack("<I", samples) + blobs)
    path.write_bytes(struct.pack("<I", len(parts)) + b"".join(parts))
    return len(parts)


if __name__ == "__main__":
    print(export(Path(sys.argv[1]), *(int(text) for text in sys.argv[2:3])), "plans")
