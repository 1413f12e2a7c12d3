"""Write a ROS 1 recording of a turtle, small and of our own making, for tests without a real one.

It has what makes a ROS 1 recording hard: a custom type that only the recording defines, a
Header with ``seq``, ``tf/tfMessage``, ``rosgraph_msgs/Log``, strings, a sequence of structs.
"""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
from rosbags.rosbag1 import Writer
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

POSE = "float32 x\nfloat32 y\nfloat32 theta\n\nfloat32 linear_velocity\nfloat32 angular_velocity\n"
COLOR = "uint8 r\nuint8 g\nuint8 b\n"
TF = "geometry_msgs/TransformStamped[] transforms\n"


def write_recording(path: Path, steps: int = 300, period_ns: int = 8_000_000) -> None:
    """Write ``steps`` poses, one every ``period_ns``, with tf, colour, commands and log beside them."""
    store = get_typestore(Stores.ROS1_NOETIC)
    for text, name in (
        (POSE, "turtlesim/msg/Pose"),
        (COLOR, "turtlesim/msg/Color"),
        (TF, "tf/msg/tfMessage"),
    ):
        store.register(get_types_from_msg(text, name))
    make = store.types
    with Writer(path) as writer:
        names = {
            "/turtle1/pose": "turtlesim/msg/Pose",
            "/turtle1/color_sensor": "turtlesim/msg/Color",
            "/turtle1/cmd_vel": "geometry_msgs/msg/Twist",
            "/tf": "tf/msg/tfMessage",
            "/joint_states": "sensor_msgs/msg/JointState",
            "/rosout": "rosgraph_msgs/msg/Log",
        }
        connections = {
            topic: writer.add_connection(topic, name, typestore=store) for topic, name in names.items()
        }

        def put(topic: str, time_ns: int, message: object) -> None:
            raw = store.serialize_ros1(message, names[topic])
            writer.write(connections[topic], time_ns, raw)

        def header(step: int, time_ns: int, frame: str) -> object:
            stamp = make["builtin_interfaces/msg/Time"](sec=time_ns // 10**9, nanosec=time_ns % 10**9)
            return make["std_msgs/msg/Header"](seq=step, stamp=stamp, frame_id=frame)

        vector = make["geometry_msgs/msg/Vector3"]
        for step in range(steps):
            now = 1_396_293_887_000_000_000 + step * period_ns
            angle = step * 0.05
            x, y = 5.5 + 2 * math.cos(angle), 5.5 + 2 * math.sin(angle)
            put("/turtle1/pose", now, make["turtlesim/msg/Pose"](x, y, angle % math.tau, 0.8, -0.4))
            put(
                "/turtle1/color_sensor",
                now + 1,
                make["turtlesim/msg/Color"](step % 256, 86, 255 - step % 256),
            )
            rotation = make["geometry_msgs/msg/Quaternion"](
                0.0, 0.0, math.sin(angle / 2), math.cos(angle / 2)
            )
            transform = make["geometry_msgs/msg/Transform"](vector(x, y, 0.0), rotation)
            stamped = make["geometry_msgs/msg/TransformStamped"](
                header(step, now, "world"), "turtle1", transform
            )
            put("/tf", now + 2, make["tf/msg/tfMessage"]([stamped] * (1 + step % 3)))
            joints = make["sensor_msgs/msg/JointState"](
                header(step, now, ""),
                ["wheel_left", "wheel_right"],
                np.array([angle, -angle]),
                np.array([], dtype=np.float64),
                np.array([0.25]),
            )
            put("/joint_states", now + 3, joints)
            if step % 4 == 0:
                put(
                    "/turtle1/cmd_vel",
                    now + 4,
                    make["geometry_msgs/msg/Twist"](vector(1.0, 0, 0), vector(0, 0, angle)),
                )
            if step % 50 == 0:
                put(
                    "/rosout",
                    now + 5,
                    make["rosgraph_msgs/msg/Log"](
                        header(step, now, ""), 2, "/turtlesim", f"Schritt {step} über den Rand", "turtle.cpp",
                        "void Turtle::update()", 205, ["/turtle1/pose", "/rosout"],
                    ),
                )  # fmt: skip
