"""Messages with fields from Python beside bare records: all fields written, and read on the other side.

usage: python -m benchmarks.bench_typed [--rounds N] [--json]

Both ways write to a channel and read from it in one process: typed with `rosplc.attach`, from a dictionary
and into every field; raw with the C core, into a buffer. "objects" is raw and, for what Python's own objects
cost, the same values through `marshal`, which is in C. What is compared is the processor's time.
"""

from __future__ import annotations

import marshal
import secrets
import time
from collections.abc import Callable
from contextlib import ExitStack
from typing import Any

from benchmarks import measure
from benchmarks.bench_codec import JOINTS, MESSAGES
from benchmarks.bench_dds import interval
from rosplc import attach
from rosplc.demo.processes import remove_objects
from rosplc.described import description_of
from rosplc.layout import Layout, Limits, compute_layout
from rosplc.model import TypeStore
from rosplc.shm import Direction, Namespace, OwnedChannel
from rosplc.shm import attach as attach_raw

BATCH = 2000
VECTOR = {"x": 0.1, "y": 0.2, "z": 0.3}
SIX = Limits(fields=dict.fromkeys(("name", "position", "velocity", "effort"), len(JOINTS)))


def read_twist(message: Any) -> tuple[Any, ...]:
    linear, angular = message.linear, message.angular
    return linear.x, linear.y, linear.z, angular.x, angular.y, angular.z


def read_joints(message: Any) -> tuple[Any, ...]:
    header = message.header
    stamp = header.stamp
    whole = (message.name, message.position, message.velocity, message.effort)
    return stamp.sec, stamp.nanosec, header.frame_id, *whole


CASES: dict[str, tuple[Limits, dict[str, Any], Callable[[Any], tuple[Any, ...]]]] = {
    "geometry_msgs/msg/Twist": (Limits(), {"linear": VECTOR, "angular": VECTOR}, read_twist),
    "sensor_msgs/msg/JointState": (SIX, MESSAGES["sensor_msgs/msg/JointState"], read_joints),
}


def round_trips(
    stack: ExitStack, layout: Layout, values: dict[str, Any], read: Callable[[Any], tuple[Any, ...]]
) -> dict[str, Callable[[], object]]:
    """Return a round trip of each kind, over a channel of its own."""
    space = Namespace(f"bench-{secrets.token_hex(4)}")
    stack.callback(remove_objects, space.prefix)
    for topic in ("/typed", "/raw"):
        about = description_of(layout, topic, Direction.TO_ROS, bridge="bench")
        owned = OwnedChannel.open(space, about, record_size=layout.size, slots=16)
        stack.callback(owned.close)
    source = stack.enter_context(attach("/typed", prefix=space.prefix, write=True))
    target = stack.enter_context(attach("/typed", prefix=space.prefix))
    ends = [attach_raw(space, "/raw", direction=Direction.TO_ROS, write=write) for write in (True, False)]
    for end in ends:
        stack.callback(end.close)
    writer, reader = ends[0].writer(beat_ms=60_000), ends[1].reader()
    record, buffer = layout.pack(values), bytearray(layout.size)

    def typed() -> tuple[Any, ...]:
        source.write(values)
        return read(target.read())

    def raw() -> bytearray:
        writer.publish(record)
        if reader.latest(buffer) is None:
            raise AssertionError("the record has not arrived")
        return buffer

    fields = read(layout.view(record))

    def objects() -> Any:
        raw()
        return marshal.loads(marshal.dumps(fields))

    if not typed() == read(layout.view(raw())) == objects():
        raise AssertionError(f"{layout.type_name}: the contenders disagree")
    return {"raw": raw, "objects": objects, "typed": typed}


def processor_us(function: Callable[[], object], batch: int) -> float:
    """Return the processor's time of one call in µs."""
    began = time.process_time_ns()
    for _ in range(batch):
        function()
    return (time.process_time_ns() - began) / batch / 1000


def run(rounds: int, batch: int = BATCH) -> dict[str, Any]:
    """Measure in ``rounds`` rounds; returns a :func:`measure.report`."""
    before, store, tables = measure.environment(), TypeStore.bundled("jazzy"), []
    for name, (limits, values, read) in CASES.items():
        found: dict[str, list[float]] = {}
        with ExitStack() as stack:
            trips = round_trips(stack, compute_layout(store, name, limits), values, read)
            for _ in range(rounds):
                for key, trip in trips.items():
                    found.setdefault(key, []).append(processor_us(trip, batch))
        rows = [measure.row("raw", found["raw"])]
        for key in ("objects", "typed"):
            lowest, highest = interval(
                [mine / its for mine, its in zip(found[key], found["raw"], strict=True)]
            )
            ratio = measure.median_ratio(found[key], found["raw"])
            rows.append(measure.row(key, found[key], ratio=ratio, lowest=lowest, highest=highest))
        tables.append(measure.table(name, "µs of CPU time per round trip", "no waiting", rows))
    return measure.report(tables, before)


if __name__ == "__main__":
    measure.main(run, __doc__, 15)
