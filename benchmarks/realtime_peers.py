"""The programs around the bridges whose real-time settings are compared; a message is the time it was sent.

    python -m benchmarks.realtime_peers source|plc ORDERS_JSON

``source`` sends an Int64 by turns to both bridges over DDS: CLOCK_MONOTONIC in nanoseconds. ``plc`` looks
into both objects every 0.2 ms, as a fast task does, and keeps the ages. Both are SCHED_FIFO, above the
bridge: what they are kept waiting is not to be measured.
"""

from __future__ import annotations

import json
import os
import struct
import sys
import time
from typing import Any

from benchmarks.latency_peers import QOS, Lines
from benchmarks.load_peers import say
from rosplc.model import TypeStore
from rosplc.ros import open_backend
from rosplc.shm import Direction, Namespace, attach

TYPE = "std_msgs/msg/Int64"
TOPIC = "/realtime/{}"
PLC_PRIORITY, SOURCE_PRIORITY = 60, 30
_LOOK_S = 0.0002


def source(order: dict[str, Any]) -> None:
    """Send on ``RATE COUNT``, so many to each bridge."""
    os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(SOURCE_PRIORITY))
    backend = open_backend("dds", TypeStore.bundled("jazzy"), "source")
    publishers = [backend.advertise(TOPIC.format(name), TYPE, QOS) for name in order["prefixes"]]
    while any(not publisher.matched for publisher in publishers):
        time.sleep(0.05)
    say(ready=True)
    for line in sys.stdin:
        rate, count = line.split()
        due = time.monotonic()
        for _ in range(int(count)):
            for publisher in publishers:
                publisher.write(b"\0\1\0\0" + struct.pack("<q", time.monotonic_ns()))
                due += 1 / float(rate) / len(publishers)
                time.sleep(max(0.0, due - time.monotonic()))
        say(sent=count)
    backend.close()


def plc(order: dict[str, Any]) -> None:
    """Look into every bridge's object; an empty line asks for the ages in microseconds."""
    os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(PLC_PRIORITY))
    readers = {}
    for name, prefix in order["prefixes"].items():
        channel = attach(Namespace(prefix), TOPIC.format(name), direction=Direction.TO_PLC)
        readers[name] = channel, channel.reader("plc")
    out = bytearray(8)
    orders = Lines()
    ages: dict[str, list[float]] = {name: [] for name in readers}
    say(ready=True)
    while not orders.ended:
        for name, (_, reader) in readers.items():
            while reader.next(out) is not None:
                ages[name].append((time.monotonic_ns() - struct.unpack("<q", out)[0]) / 1000)
        if orders.asked():
            say(ages=ages)
            ages = {name: [] for name in readers}
        time.sleep(_LOOK_S)


if __name__ == "__main__":
    {"source": source, "plc": plc}[sys.argv[1]](json.loads(sys.argv[2]))
