"""Transforms: what a hundred frames cost at 100 Hz, beside a plain deserializer.

usage: python -m benchmarks.bench_transforms [--rounds N] [--json]

A second of a robot with a hundred frames, a chain of ten of them: the bridge receives it, and looks a pose
up for every entry. The alternative only turns the same messages into Python objects (rosbags), without a
buffer or a lookup. All run in every round, in turn.
"""

from __future__ import annotations

import time
from typing import Any

from rosbags.typesys import Stores, get_typestore

from benchmarks import measure
from rosplc.bridge.port import Context
from rosplc.bridge.transforms import Transforms
from rosplc.codec import Codec, Wire
from rosplc.config.transforms import TF_MESSAGE
from rosplc.layout import Limits, compute_layout
from rosplc.model import TypeStore
from rosplc.ros.memory import open_apart
from rosplc.shm import Namespace

FRAMES, CHAIN, HERTZ = 100, 10, 100
_PERIOD_NS = 10**9 // HERTZ
ONE, EACH, ROSBAGS, POSE = (
    "received, 100 transforms in a message",
    "received, 100 transforms in 100 messages",
    "rosbags alone, 100 transforms in a message",
    "a pose through 10 frames, interpolated",
)


class Robot:
    """A node that publishes, and the bridge's side of it without a middleware between them."""

    def __init__(self) -> None:
        store = TypeStore.bundled("jazzy")
        self.codec = Codec(compute_layout(store, TF_MESSAGE, Limits(80, FRAMES, {})), Wire.CDR)
        self.transforms = Transforms(Context(Namespace("bench"), "bench", bytes(16), "jazzy"))
        self.receive: Any = None
        (self.backend,) = open_apart(store, "robot")
        self.deserialize = get_typestore(Stores.ROS2_JAZZY).deserialize_cdr
        self.stamp_ns = 10**18

    def subscribe(self, topic: str, _type: str, _qos: Any, receive: Any) -> Any:
        """Take the bridge's receiver, as a backend does."""
        if topic == "/tf":
            self.receive = receive
        return self.backend.subscribe(topic, TF_MESSAGE, _qos, receive)

    def messages(self, size: int) -> list[bytes]:
        """Return all frames at the next time, ``size`` in a message."""
        self.stamp_ns += _PERIOD_NS
        # A chain, and leaves on its frames. Every second transform is half a period late.
        stamps = [divmod(self.stamp_ns - late, 10**9) for late in (0, _PERIOD_NS // 2)]
        links = [
            {
                "header": {
                    "stamp": dict(zip(("sec", "nanosec"), stamps[number % 2], strict=True)),
                    "frame_id": f"frame{number if number < CHAIN else number % CHAIN}",
                },
                "child_frame_id": f"frame{number + 1}",
                "transform": {"translation": {"x": 0.1}, "rotation": {"z": 0.6, "w": 0.8}},
            }
            for number in range(FRAMES)
        ]
        parts = (links[at : at + size] for at in range(0, FRAMES, size))
        return [self.codec.encode(self.codec.layout.pack({"transforms": part})) for part in parts]

    def received(self, size: int) -> float:
        """Return the ns that the bridge needs for all frames once."""
        messages = self.messages(size)
        start = time.perf_counter_ns()
        for data in messages:
            self.receive(data, 0)
        return time.perf_counter_ns() - start

    def deserialized(self) -> float:
        """Return the ns that rosbags needs for the same message."""
        (data,) = self.messages(FRAMES)
        start = time.perf_counter_ns()
        self.deserialize(data, TF_MESSAGE)
        return time.perf_counter_ns() - start

    def pose(self) -> float:
        """Return the ns of a lookup."""
        start = time.perf_counter_ns()
        found = self.transforms.buffer.lookup("frame0", f"frame{CHAIN}")
        taken = time.perf_counter_ns() - start
        if found.error:
            raise RuntimeError(f"there is no pose: {found}")
        return taken


def run(rounds: int) -> dict[str, Any]:
    """Return the costs of each, and what they are of a core at 100 Hz."""
    before, robot = measure.environment(), Robot()
    robot.transforms.join(robot, robot, robot.codec)  # type: ignore[arg-type]
    for _ in range(3):
        robot.received(FRAMES)
    values = measure.turns(
        {
            ONE: lambda: {ONE: [robot.received(FRAMES)]},
            EACH: lambda: {EACH: [robot.received(1)]},
            ROSBAGS: lambda: {ROSBAGS: [robot.deserialized()]},
            POSE: lambda: {POSE: [robot.pose() for _ in range(10)]},
        },
        rounds,
    )
    robot.transforms.leave(robot)
    robot.backend.close()
    rows = [measure.row(name, [ns / 1000 for ns in values[name]]) for name in (ONE, EACH, ROSBAGS, POSE)]
    median = {each["name"]: each["median"] for each in rows}
    facts = {
        "of_a_core_at_100_hz": {name: median[name] * HERTZ / 1e6 for name in (ONE, EACH, POSE)},
        "times_rosbags": measure.median_ratio(values[ONE], values[ROSBAGS]),
    }
    waiting = "no waiting: calls in one thread, without a middleware"
    return measure.report([measure.table("100 frames", "us", waiting, rows, facts)], before)


if __name__ == "__main__":
    measure.main(run, __doc__, 200)
