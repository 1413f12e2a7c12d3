"""The programs around the bridge whose latency is measured; each message carries when it was sent.

    python -m benchmarks.latency_peers source|subscriber|spinner ORDERS_JSON

A message's stamp is CLOCK_MONOTONIC, which all processes of one machine share. ``source`` sends by
turns over DDS to the bare subscriber and into the path that is measured. ``subscriber`` sleeps in a
WaitSet of the cyclonedds wheel and takes raw bytes, nothing more; DDS' own stamp, which the bridge sets
when it has taken a message from shared memory, tells it how long that message had lain there.
``spinner`` looks for a new record all the time, as a PLC task on a core of its own would.
"""

from __future__ import annotations

import json
import os
import struct
import sys
import time
from typing import Any

from benchmarks.load_peers import TYPE, Orders, patterns, say
from rosplc.model import TypeStore
from rosplc.ros import Qos, open_backend
from rosplc.shm import Direction, Namespace, attach

BARE, TO_PLC, TO_ROS = "/latency/bare", "/latency/to_plc", "/latency/to_ros"
SENT = "since the bridge took it"
QOS = Qos(reliability="reliable", durability="volatile", depth=1000)
_STAMP = struct.Struct("<iI")


def stamp(message: bytearray, at: int) -> None:
    """Write the time into a message."""
    _STAMP.pack_into(message, at, *divmod(time.monotonic_ns(), 1_000_000_000))


def age_us(message: bytes | bytearray, at: int, now_ns: int) -> float:
    """Return how long ago a message was sent, in microseconds."""
    seconds, nanoseconds = _STAMP.unpack_from(message, at)
    return float(now_ns - seconds * 1_000_000_000 - nanoseconds) / 1000


def source(order: dict[str, Any]) -> None:
    """Send: on ``in RATE COUNT`` into the bridge over DDS, on ``out RATE COUNT`` through shared memory."""
    wire, records = patterns()
    message, record = wire(0).of(0), records(0).of(0)
    backend = open_backend("dds", TypeStore.bundled("jazzy"), "source")
    publishers = {topic: backend.advertise(topic, TYPE, QOS) for topic in (BARE, TO_PLC)}
    attached = attach(Namespace(order["prefix"]), TO_ROS, direction=Direction.TO_ROS, write=True)
    writer = attached.writer(beat_ms=60_000)
    while any(not publisher.matched for publisher in publishers.values()):
        time.sleep(0.05)
    say(ready=True)

    def send(topic: str) -> None:
        stamp(message, 4)
        publishers[topic].write(bytes(message))

    def through_memory() -> None:
        stamp(record, 0)
        writer.publish(record)

    for line in sys.stdin:
        kind, rate, count = line.split()
        half = 0.5 / float(rate)
        due = time.monotonic()
        for _ in range(int(count)):
            send(BARE)
            due += half
            time.sleep(max(0.0, due - time.monotonic()))
            if kind == "in":
                send(TO_PLC)
            else:
                through_memory()
            due += half
            time.sleep(max(0.0, due - time.monotonic()))
        say(sent=count)
    backend.close()


def subscriber(order: dict[str, Any]) -> None:
    """Receive over DDS with nothing but the cyclonedds wheel; an empty line asks for the ages."""
    from cyclonedds._clayer import ddspy_take
    from cyclonedds.core import InstanceState, ReadCondition, SampleState, ViewState, WaitSet
    from cyclonedds.domain import Domain, DomainParticipant
    from cyclonedds.sub import DataReader
    from cyclonedds.topic import Topic
    from cyclonedds.util import duration

    from rosplc.ros.dds.backend import dds_qos
    from rosplc.ros.dds.config import domain_config
    from rosplc.ros.dds.idl import IdlTypes, dds_topic

    store = TypeStore.bundled("jazzy")
    number = int(os.environ["ROS_DOMAIN_ID"])
    domain = Domain(number, domain_config(os.environ, "jazzy"))
    participant = DomainParticipant(number)
    kind = IdlTypes(store)[TYPE]
    waitset = WaitSet(participant)
    anything = SampleState.Any | ViewState.Any | InstanceState.Any
    readers = {}
    for topic in (BARE, TO_ROS):
        reader = DataReader(participant, Topic(participant, dds_topic(topic), kind), dds_qos(QOS, ""))
        condition = ReadCondition(reader, anything)
        waitset.attach(condition)
        readers[topic] = (reader, condition)
    orders = Lines()
    ages: dict[str, list[float]] = {BARE: [], TO_ROS: []}
    since_sent: list[float] = []
    say(ready=True)
    while not orders.ended:
        waitset.wait(duration(milliseconds=100))
        for topic, (reader, _) in readers.items():
            for data, info in ddspy_take(reader._ref, int(anything), 100):
                if info.valid_data:
                    now = time.monotonic_ns()
                    ages[topic].append(age_us(data, 4, now))
                    if topic == TO_ROS:
                        since_sent.append((time.time_ns() - info.source_timestamp) / 1000)
        if orders.asked():
            say(ages={**ages, SENT: since_sent})
            ages, since_sent = {topic: [] for topic in ages}, []
    del domain


def spinner(order: dict[str, Any]) -> None:
    """Read the record without ever sleeping; an empty line asks for the ages."""
    attached = attach(Namespace(order["prefix"]), TO_PLC, direction=Direction.TO_PLC)
    reader = attached.reader("spinner")
    record = bytearray(attached.identity.record_size)
    orders = Lines()
    ages: list[float] = []
    say(ready=True)
    latest, now = reader.latest, time.monotonic_ns
    while not orders.ended:
        if latest(record) is not None:
            ages.append(age_us(record, 0, now()))
        elif orders.asked():
            say(ages={TO_PLC: ages})
            ages = []


class Lines(Orders):
    """Counts the lines on standard input."""

    def __init__(self) -> None:
        self._asked = 0
        self.ended = False
        super().__init__()

    def _read(self) -> None:
        for _ in sys.stdin:
            self._asked += 1
        self.ended = True

    def asked(self) -> bool:
        """Return whether there is a line not answered yet."""
        if not self._asked:
            return False
        self._asked -= 1
        return True


if __name__ == "__main__":
    {"source": source, "subscriber": subscriber, "spinner": spinner}[sys.argv[1]](json.loads(sys.argv[2]))
