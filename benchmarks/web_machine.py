"""A machine to look at: a process in the bridge's place and one in the PLC's, with lively channels.

    python -m benchmarks.web_machine bridge PREFIX [COUNT]
    python -m benchmarks.web_machine plc PREFIX [COUNT]

Each prints ``ready`` and runs until its standard input ends. ``COUNT`` adds so many channels
``/line/sensor_NNN``. Nothing here takes part in ROS: what is looked at lies in shared memory.
"""

from __future__ import annotations

import math
import random
import sys
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

from rosplc import bind
from rosplc.bridge.bind import Binding
from rosplc.virtual_plc import ReadBlock, VirtualPlc, WriteBlock

JOINTS = [f"axis_{number}" for number in range(1, 7)]
BEAMS = 96
TICK = 0.005


@dataclass(frozen=True)
class Source:
    """A topic towards the PLC: its type, its rate (0: one message), and what it says at a time in seconds."""

    type: str
    hz: float
    message: Callable[[float], dict[str, Any]]
    limits: dict[str, int] = field(default_factory=dict)
    read: bool = True


def header(at: float, frame: str) -> dict[str, Any]:
    return {"stamp": {"sec": int(at), "nanosec": int(at % 1 * 1e9)}, "frame_id": frame}


def swing(at: float, period: float, size: float = 1.0, phase: float = 0.0) -> float:
    return size * math.sin(2 * math.pi * at / period + phase)


def joints(at: float) -> dict[str, Any]:
    return {
        "header": header(at, "base_link"),
        "name": JOINTS,
        "position": [swing(at, 6 + each, 1.2 / (1 + each / 3), each) for each in range(6)],
        "velocity": [swing(at, 6 + each, 0.8 / (1 + each / 3), each + 1.57) for each in range(6)],
        "effort": [swing(at, 3, 12 - each) + random.gauss(0, 0.4) for each in range(6)],
    }


def xyz(x: float, y: float, z: float) -> dict[str, float]:
    return {"x": x, "y": y, "z": z}


def pose(at: float) -> dict[str, Any]:
    half = swing(at, 9, 0.6)
    position = xyz(0.62 + swing(at, 8, 0.21), swing(at, 6, 0.34), 0.41 + abs(swing(at, 4, 0.12)))
    turned = {"x": 0.0, "y": 0.0, "z": math.sin(half), "w": math.cos(half)}
    return {"header": header(at, "world"), "pose": {"position": position, "orientation": turned}}


def wrench(at: float) -> dict[str, Any]:
    pressed = max(0.0, swing(at, 5)) ** 3
    force = xyz(random.gauss(0, 0.3), random.gauss(0, 0.3), -42 * pressed + random.gauss(0, 0.5))
    torque = xyz(random.gauss(0, 0.02), random.gauss(0, 0.02), 1.4 * pressed)
    return {"header": header(at, "tool0"), "wrench": {"force": force, "torque": torque}}


def scan(at: float) -> dict[str, Any]:
    walls = [2.4 + abs(swing(each / BEAMS, 0.5, 1.1)) for each in range(BEAMS)]
    person = int(BEAMS * (0.5 + swing(at, 12, 0.4)))
    ranges = [
        min(wall, 1.1 + 0.05 * abs(each - person)) if abs(each - person) < 5 else wall
        for each, wall in enumerate(walls)
    ]
    angles = {"angle_min": -2.3, "angle_max": 2.3, "angle_increment": 4.6 / BEAMS}
    measured = [distance + random.gauss(0, 0.01) for distance in ranges]
    bounds = {"range_min": 0.05, "range_max": 12.0}
    return {"header": header(at, "scanner"), **angles, **bounds, "ranges": measured}


def temperature(at: float) -> dict[str, Any]:
    return {"header": header(at, "spindle"), "temperature": 41.5 + swing(at, 60, 3), "variance": 0.04}


def battery(at: float) -> dict[str, Any]:
    return {
        "header": header(at, "agv"),
        "voltage": 48.2 + swing(at, 40, 0.6),
        "current": -6.1 + swing(at, 7, 2),
        "percentage": 0.82 - at % 600 / 6000,
        "present": True,
        "capacity": float("nan"),
        "serial_number": "AGV-0117",
    }


def sensor(number: int) -> Callable[[float], dict[str, Any]]:
    return lambda at: {"data": 20 + number / 10 + swing(at, 5 + number % 7, 2, number)}


SOURCES = {
    "/robot1/joint_states": Source(
        "sensor_msgs/msg/JointState", 50, joints, {"name": 6, "position": 6, "velocity": 6, "effort": 6}
    ),
    "/robot1/tcp_pose": Source("geometry_msgs/msg/PoseStamped", 50, pose),
    "/robot1/wrench": Source("geometry_msgs/msg/WrenchStamped", 100, wrench),
    "/agv/battery": Source("sensor_msgs/msg/BatteryState", 2, battery),
    "/agv/scan": Source("sensor_msgs/msg/LaserScan", 10, scan, {"ranges": BEAMS, "intensities": 1}),
    "/spindle/temperature": Source("sensor_msgs/msg/Temperature", 4, temperature),
    "/vision/part_pose": Source("geometry_msgs/msg/PoseStamped", 0, pose),
    "/press/door_open": Source("std_msgs/msg/Bool", 5, lambda at: {"data": at % 20 < 5}, read=False),
}

COMMANDS = {
    "/robot1/speed_override": "std_msgs/msg/Float64",
    "/cell/state": "std_msgs/msg/UInt8",
    "/conveyor/cmd_vel": "geometry_msgs/msg/Twist",
}
UNUSED = {"/cell/test": "geometry_msgs/msg/Twist"}


def sources(count: int) -> dict[str, Source]:
    """Return the topics towards the PLC."""
    more = {
        f"/line/sensor_{number:03}": Source("std_msgs/msg/Float64", 10, sensor(number))
        for number in range(1, count + 1)
    }
    return SOURCES | more


def bridge(prefix: str, count: int, stopped: threading.Event) -> None:
    """Take the bridge's place: write what comes from the robot, take what the PLC says."""
    topics = sources(count)
    writers: list[tuple[Source, Binding]] = [
        (source, bind(topic, source.type, limits=source.limits, prefix=prefix, slots=16, name="cell1"))
        for topic, source in topics.items()
    ]
    taken = [
        bind(topic, type_name, "to_ros", prefix=prefix, name="cell1")
        for topic, type_name in (COMMANDS | UNUSED).items()
    ]
    print("ready", flush=True)
    # Spread, so that not all of one rate are due in one moment.
    due = [time.monotonic() + random.random() / max(source.hz, 1) for source, _ in writers]
    for _, writer in writers:
        writer._user.set_sources(1)  # as a bridge says that a robot is there
    while not stopped.wait(TICK):
        now, wall = time.monotonic(), time.time()
        for index, (source, writer) in enumerate(writers):
            if now >= due[index]:
                writer.write(source.message(wall))
                due[index] = max(due[index] + 1 / source.hz, now) if source.hz else math.inf
        for reader in taken:
            reader.read()


def plc(prefix: str, count: int, stopped: threading.Event) -> None:
    """Take the PLC's place: read every topic, steer with some."""
    reads = [ReadBlock(topic, prefix=prefix) for topic, source in sources(count).items() if source.read]
    writes = {topic: WriteBlock(topic, prefix=prefix) for topic in COMMANDS}
    machine = VirtualPlc()
    task = machine.task("MainTask", interval=0.02)

    @task.program
    def main() -> None:
        for read in reads:
            read()
        at = time.time()
        values: dict[str, dict[str, Any]] = {
            "/robot1/speed_override": {"data": 0.8 if at % 20 > 5 else 0.25},
            "/cell/state": {"data": int(at / 4) % 5},
            "/conveyor/cmd_vel": {"linear": {"x": 0.3 + swing(at, 14, 0.1)}},
        }
        for topic, write in writes.items():
            write.xEnable = write.msg is not None
            if write.msg is not None:
                write.msg.update(values[topic])
            write()

    machine.start()
    print("ready", flush=True)
    stopped.wait()
    machine.stop()


def main() -> None:
    role, prefix = sys.argv[1:3]
    count = int(sys.argv[3]) if len(sys.argv) > 3 else 0
    stopped = threading.Event()
    threading.Thread(target=lambda: (sys.stdin.read(), stopped.set()), daemon=True).start()
    {"bridge": bridge, "plc": plc}[role](prefix, count, stopped)


if __name__ == "__main__":
    main()
