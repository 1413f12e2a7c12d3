"""Decode and encode cost per message: the plan against rosbags and struct.pack.

usage: python -m benchmarks.bench_codec [--rounds N] [--json]

The alternative turns a message into the same record the way one would without rosplc: rosbags
deserializes it, then struct packs the fields. All contenders run in every round, in turn, so that a
slow moment of the machine hits them alike; a round's value is the mean over a batch.
"""

from __future__ import annotations

import struct
from collections.abc import Callable
from typing import Any

from rosbags.typesys import Stores, get_typestore

from benchmarks import measure
from rosplc.codec import Codec, Wire
from rosplc.layout import Limits, compute_layout
from rosplc.model import TypeStore

BATCH = 2000
STAMP: dict[str, Any] = {"stamp": {"sec": 1700000000, "nanosec": 123456789}, "frame_id": "base_link"}
POSE = {"position": {"x": 1.0, "y": 2.0, "z": 3.0}, "orientation": {"x": 0.0, "y": 0.0, "z": 0.6, "w": 0.8}}
JOINTS = [f"joint_{number}" for number in range(1, 7)]
MESSAGES: dict[str, dict[str, Any]] = {
    "geometry_msgs/msg/PoseStamped": {"header": STAMP, "pose": POSE},
    "sensor_msgs/msg/JointState": {
        "header": STAMP,
        "name": JOINTS,
        "position": [0.1 * number for number in range(6)],
        "velocity": [0.2 * number for number in range(6)],
        "effort": [0.3 * number for number in range(6)],
    },
    "sensor_msgs/msg/Imu": {"header": STAMP, "orientation_covariance": [0.5] * 9},
}
LIMITS = Limits(fields={})


def pack_pose(message: Any) -> bytes:
    stamp, p, q = message.header.stamp, message.pose.position, message.pose.orientation
    frame = message.header.frame_id.encode()
    return _POSE.pack(stamp.sec, stamp.nanosec, frame, p.x, p.y, p.z, q.x, q.y, q.z, q.w)


def pack_joints(message: Any) -> bytes:
    stamp = message.header.stamp
    parts = [_JOINTS_HEAD.pack(stamp.sec, stamp.nanosec, message.header.frame_id.encode(), len(message.name))]
    parts += [name.encode().ljust(81, b"\0") for name in message.name]
    parts.append(bytes((16 - len(message.name)) * 81))
    for values in (message.position, message.velocity, message.effort):
        parts += [struct.pack("<I4x", len(values)), values.tobytes(), bytes((16 - len(values)) * 8)]
    return b"".join(parts)


def pack_imu(message: Any) -> bytes:
    stamp, q = message.header.stamp, message.orientation
    w, a = message.angular_velocity, message.linear_acceleration
    head = _IMU.pack(stamp.sec, stamp.nanosec, message.header.frame_id.encode(), q.x, q.y, q.z, q.w)
    return bytes(
        head
        + message.orientation_covariance.tobytes()
        + struct.pack("<3d", w.x, w.y, w.z)
        + message.angular_velocity_covariance.tobytes()
        + struct.pack("<3d", a.x, a.y, a.z)
        + message.linear_acceleration_covariance.tobytes()
    )


_POSE = struct.Struct("<iI81s7x7d")
_JOINTS_HEAD = struct.Struct("<iI81s3xI")
_IMU = struct.Struct("<iI81s7x4d")
PACKERS: dict[str, Callable[[Any], bytes]] = {
    "geometry_msgs/msg/PoseStamped": pack_pose,
    "sensor_msgs/msg/JointState": pack_joints,
    "sensor_msgs/msg/Imu": pack_imu,
}


def contenders(name: str, store: TypeStore) -> dict[str, Callable[[], object]]:
    """Return what is measured for a type, after checking that all come to the same record."""
    codec = Codec(compute_layout(store, name), Wire.CDR)
    rosbags = get_typestore(Stores.ROS2_JAZZY)
    record = bytearray(codec.layout.pack(MESSAGES[name]))
    message = codec.encode(record)
    pack, out, wire = PACKERS[name], bytearray(len(record)), bytearray(codec.plan.encoded_bound)
    deserialize, decode_into, encode_into = (
        rosbags.deserialize_cdr,
        codec.plan.decode_into,
        codec.plan.encode_into,
    )
    decoded = rosbags.deserialize_cdr(message, name)
    if pack(decoded) != bytes(record) or codec.decode(message) != bytes(record):
        raise AssertionError(f"{name}: the contenders disagree")
    return {
        "rosbags + struct": lambda: pack(deserialize(message, name)),
        "decode (Codec)": lambda: codec.decode(message),
        "decode (plan)": lambda: decode_into(message, out),
        "encode (rosbags)": lambda: rosbags.serialize_cdr(decoded, name),
        "encode (Codec)": lambda: codec.encode(record),
        "encode (plan)": lambda: encode_into(record, wire),
        "nothing (the call)": lambda: None,
    }


def run(rounds: int) -> dict[str, Any]:
    """Measure in ``rounds`` rounds; returns a :func:`measure.report`.

    A ratio tells how many times faster than rosbags in the same direction a contender is; nothing is
    subtracted.
    """
    before = measure.environment()
    store = TypeStore.bundled("jazzy")
    measured = {name: contenders(name, store) for name in MESSAGES}
    times: dict[str, dict[str, list[float]]] = {
        name: {key: [] for key in these} for name, these in measured.items()
    }
    for _ in range(rounds):
        for name, these in measured.items():
            for key, function in these.items():
                batch = BATCH // 10 if "rosbags" in key else BATCH
                times[name][key].append(measure.mean_ns(function, batch) / 1000)
    tables = []
    for name, found in times.items():
        lines = []
        for key, values in found.items():
            base = found["encode (rosbags)" if key.startswith("encode") else "rosbags + struct"]
            faster = None if key.startswith("nothing") else measure.median_ratio(base, values)
            lines.append(measure.row(key, values, **{"times faster": faster}))
        tables.append(measure.table(name, "µs per message", "no waiting", lines))
    return measure.report(tables, before)


if __name__ == "__main__":
    measure.main(run, __doc__, 15)
