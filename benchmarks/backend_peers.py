"""The programs around a bridge on any backend; each message carries when it was sent, and its number.

    python -m benchmarks.backend_peers source|subscriber|spinner|counter ORDERS_JSON

``source`` and ``subscriber`` are nodes on the backend that is measured, without a bridge. ``spinner`` looks
for a new record all the time, as a PLC task on a core of its own would; ``counter`` takes every record
in order, a thousand times a second.
"""

from __future__ import annotations

import json
import sys
import time
from typing import Any

from benchmarks.latency_peers import Lines, age_us, stamp
from benchmarks.load_peers import TYPE, join, patterns, say, stamp_places
from rosplc.ros import Qos
from rosplc.shm import Direction, Namespace, attach

BARE, TO_PLC, TO_ROS, EVERY = "/backend/bare", "/backend/to_plc", "/backend/to_ros", "/backend/every"
QOS = Qos(reliability="reliable", durability="volatile", depth=5000)


def source(order: dict[str, Any]) -> None:
    """Send by turns: ``in``/``out RATE COUNT`` for latency, ``flood TOPIC RATE COUNT`` for rates."""
    distro = order["distro"]
    wire, records = patterns(distro)
    on_wire, in_record = stamp_places(distro)
    message, record = wire(0).of(0), records(0).of(0)
    backend = join(order, "source")
    publishers = {topic: backend.advertise(topic, TYPE, QOS) for topic in (BARE, TO_PLC, EVERY)}
    attached = attach(Namespace(order["prefix"]), TO_ROS, direction=Direction.TO_ROS, write=True)
    writer = attached.writer(beat_ms=60_000)
    while any(not publisher.matched for publisher in publishers.values()):
        time.sleep(0.05)
    say(ready=True)

    def send(topic: str) -> None:
        stamp(message, on_wire)
        publishers[topic].write(bytes(message))

    def through_memory() -> None:
        stamp(record, in_record)
        writer.publish(record)

    for line in sys.stdin:
        kind, *rest = line.split()
        if kind == "flood":
            say(took=flood(publishers[rest[0]], bytes(message), float(rest[1]), int(rest[2])))
            continue
        half = 0.5 / float(rest[0])
        due = time.monotonic()
        for _ in range(int(rest[1])):
            send(BARE)
            due += half
            time.sleep(max(0.0, due - time.monotonic()))
            send(TO_PLC) if kind == "in" else through_memory()
            due += half
            time.sleep(max(0.0, due - time.monotonic()))
        say(sent=int(rest[1]))
    backend.close()


def flood(publisher: Any, payload: bytes, rate: float, count: int) -> float:
    """Send at a rate, in bursts of a millisecond; return the seconds that it took."""
    start = time.monotonic()
    sent = 0
    while sent < count:
        due = min(count, int((time.monotonic() - start) * rate) + 1)
        for _ in range(due - sent):
            publisher.write(payload)
        sent = max(sent, due)
        time.sleep(0.001)
    return time.monotonic() - start


def subscriber(order: dict[str, Any]) -> None:
    """Receive without a bridge; an empty line asks for ages and counts since the last one."""
    at, _ = stamp_places(order["distro"])
    ages: dict[str, list[float]] = {BARE: [], TO_ROS: []}
    backend = join(order, "subscriber")
    for topic in ages:
        backend.subscribe(
            topic,
            TYPE,
            QOS,
            lambda data, _, t=topic: ages[t].append(age_us(data, at, time.monotonic_ns())),  # type: ignore[misc]
        )
    orders = Lines()
    say(ready=True)
    while not orders.ended:
        time.sleep(0.02)
        if orders.asked():
            found = {topic: values[:] for topic, values in ages.items()}
            for topic, values in found.items():
                del ages[topic][: len(values)]
            say(ages=found)
    backend.close()


def spinner(order: dict[str, Any]) -> None:
    """Read the record without ever sleeping; an empty line asks for the ages."""
    _, at = stamp_places(order["distro"])
    attached = attach(Namespace(order["prefix"]), TO_PLC, direction=Direction.TO_PLC)
    reader = attached.reader("spinner")
    record = bytearray(attached.identity.record_size)
    orders = Lines()
    ages: list[float] = []
    say(ready=True)
    while not orders.ended:
        if reader.latest(record) is not None:
            ages.append(age_us(record, at, time.monotonic_ns()))
        elif orders.asked():
            say(ages={TO_PLC: ages})
            ages = []


def counter(order: dict[str, Any]) -> None:
    """Take every record in order; an empty line asks how many there were since the last one."""
    attached = attach(Namespace(order["prefix"]), EVERY, direction=Direction.TO_PLC, write=True)
    reader = attached.reader("counter", observe=False)
    record = bytearray(attached.identity.record_size)
    orders = Lines()
    count = 0
    say(ready=True)
    while not orders.ended:
        time.sleep(0.001)
        while reader.next(record) is not None:
            count += 1
        if orders.asked():
            say(count=count, lost=reader.lost)
            count = 0


if __name__ == "__main__":
    roles = {"source": source, "subscriber": subscriber, "spinner": spinner, "counter": counter}
    roles[sys.argv[1]](json.loads(sys.argv[2]))
