"""The programs around a bridge or in its place, as processes that answer in lines of JSON.

    python -m benchmarks.peers ROLE PLAN_JSON

Messages carry their number and what follows from it, or the CLOCK_MONOTONIC time at which they were sent,
which all processes of one machine share.
"""

from __future__ import annotations

import asyncio
import gc
import itertools
import json
import os
import struct
import sys
import threading
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import ExitStack
from dataclasses import asdict, dataclass
from functools import partial
from typing import Any, TypeVar

from rosplc.codec import Codec
from rosplc.described import description_of
from rosplc.layout import Layout, Limits, compute_layout
from rosplc.model import TypeStore
from rosplc.ros import ROS1, SERVICES, Backend, Qos, open_backend
from rosplc.shm import Direction, Namespace, OwnedChannel, attach
from rosplc.shm.classic import ClassicObject, Entry
from rosplc.virtual_plc import ServiceServer, Task
from rosplc_bench.process import reply

TYPE, IMAGE = "geometry_msgs/msg/PoseStamped", "sensor_msgs/msg/Image"
STRING = 119  # the longest frame_id; with it a message has about 200 bytes
BARE, TO_PLC, TO_ROS, EVERY = "/bench/bare", "/bench/to_plc", "/bench/to_ros", "/bench/every"
SENT = "since the bridge took it"
REALTIME_TYPE, REALTIME_TOPIC = "std_msgs/msg/Int64", "/realtime/{}"
QOS = Qos(reliability="reliable", durability="volatile", depth=5000)
_POSE, _NUMBER, _STAMP, _TIME = (
    struct.Struct("<7d"),
    struct.Struct("<i"),
    struct.Struct("<iI"),
    struct.Struct("<q"),
)
_CLASSIC_SCAN_S, _HOLD_EVERY_NS = 0.0001, 10_000_000
_REALTIME_SCAN_S, _PLC_PRIORITY, _SOURCE_PRIORITY = 0.001, 60, 30

Plan = dict[str, Any]
T = TypeVar("T")


def names(kind: str, count: int) -> list[str]:
    """Return topic names such as ``/load/in_3``."""
    return [f"/load/{kind}_{index}" for index in range(count)]


class Pattern:
    """The bytes of one topic's messages; ``number_at`` and the end differ from message to message."""

    def __init__(self, template: bytes, number_at: int, topic: int) -> None:
        self.bytes = bytearray(template)
        self._number_at, self._pose_at, self._topic = number_at, len(template) - _POSE.size, topic

    def of(self, number: int) -> bytearray:
        """Return message ``number``; the buffer is used again."""
        _NUMBER.pack_into(self.bytes, self._number_at, number)
        half, topic = number / 2, self._topic
        _POSE.pack_into(self.bytes, self._pose_at, number, topic, half, -number, number + topic, 0.5, half)
        return self.bytes

    def number(self, message: bytes | bytearray) -> int:
        """Return the number that a message carries."""
        return int(_NUMBER.unpack_from(message, self._number_at)[0])


def stamp_places(distro: str) -> tuple[int, int]:
    """Return where the stamp is on the wire (after CDR's header or ROS 1's seq) and in the record."""
    return 4, 4 if distro == ROS1 else 0


def image_layout(size: int) -> Layout:
    """Return the layout of images of so many bytes."""
    return compute_layout(TypeStore.bundled("jazzy"), IMAGE, Limits(string=STRING, fields={"data": size}))


def patterns(
    distro: str = "jazzy", image: int = 0
) -> tuple[Callable[[int], Pattern], Callable[[int], Pattern]]:
    """Return how messages of a topic look on the wire, and how as records; ``image``: of so many bytes."""
    layout = compute_layout(TypeStore.bundled(distro), TYPE, Limits(string=STRING))
    codec = Codec(image_layout(image) if image else layout)
    value: dict[str, Any] = {"header": {"frame_id": "f" * STRING}}
    record = bytes(codec.layout.pack(value | {"encoding": "rgb8", "data": bytes(image)} if image else value))
    wire = codec.encode(record)
    on_wire, in_record = stamp_places(distro)
    return (lambda topic: Pattern(wire, on_wire, topic)), (lambda topic: Pattern(record, in_record, topic))


def connect(plan: Plan, name: str) -> Backend:
    """Connect to the plan's ROS graph: by default ROS 2 over DDS."""
    store = TypeStore.bundled(plan.get("distro", "jazzy"))
    return open_backend(
        plan.get("backend", "dds"), store, name, domain=plan.get("domain"), options=plan.get("options")
    )


def stamp(message: bytearray, at: int) -> None:
    """Write the time into a message."""
    _STAMP.pack_into(message, at, *divmod(time.monotonic_ns(), 1_000_000_000))


def age_us(message: bytes | bytearray, at: int) -> float:
    """Return how long ago a message was sent, in microseconds."""
    now = time.monotonic_ns()
    seconds, nanoseconds = _STAMP.unpack_from(message, at)
    return float(now - seconds * 1_000_000_000 - nanoseconds) / 1000


def wait_for_match(*publishers: Any) -> None:
    """Wait until each publisher has a subscriber."""
    while any(not publisher.matched for publisher in publishers):
        time.sleep(0.05)


def paced(period: float, turns: Iterable[T] | None = None) -> Iterator[T]:
    """Yield each turn, by default without end, at its time on a grid of ``period`` seconds."""
    due = time.monotonic()
    for turn in itertools.count() if turns is None else turns:
        yield turn  # type: ignore[misc]
        due += period
        time.sleep(max(0.0, due - time.monotonic()))


class Requests:
    """Standard input, read by a thread: words that were given, and empty lines that ask for a report."""

    def __init__(self) -> None:
        self._given: dict[str, threading.Event] = {word: threading.Event() for word in ("go", "more")}
        self._asked = 0
        self.ended = False
        threading.Thread(target=self._read, daemon=True).start()

    def _read(self) -> None:
        for line in sys.stdin:
            word = line.strip()
            if word == "stop":
                break
            if word:
                self._given[word].set()
            else:
                self._asked += 1
        self.ended = True
        for event in self._given.values():
            event.set()

    def wait(self) -> None:
        """Wait for ``go`` or the end."""
        self._given["go"].wait()

    def allowed(self, number: int, count: int) -> bool:
        """Return whether message ``number`` may be sent: the first after ``go``, others after ``more``."""
        return number <= count and self._given["go" if number == 1 else "more"].is_set()

    def asked(self) -> bool:
        """Return whether a report was asked for that has not been given."""
        if not self._asked:
            return False
        self._asked -= 1
        return True

    def paced(self, period: float) -> Iterator[int]:
        """Yield every ``period`` seconds until told to stop; late turns are made up for."""
        return itertools.takewhile(lambda _: not self.ended, paced(period))


# A loaded bridge: every message is checked


@dataclass
class Tally:
    """What arrived on one topic."""

    received: int = 0
    missing: int = 0
    wrong: int = 0
    last: int = 0

    def add(self, message: bytes | bytearray, pattern: Pattern) -> None:
        """Count a message after comparing every byte."""
        number = pattern.number(message)
        if number <= self.last or pattern.of(number) != message:
            self.wrong += 1
            return
        self.received += 1
        self.missing += number - self.last - 1
        self.last = number

    def receiver(self, pattern: Pattern) -> Callable[[bytes, int], None]:
        """Return what a backend calls with each message."""
        return lambda data, _stamp_ns: self.add(data, pattern)


class Load:
    """One end of a load: sends numbered messages when it may, and checks what arrives.

    It reports once that every topic has received a message: from there on readers count losses. With
    ``until_last`` in the plan it also reports that every topic has the last one.
    """

    def __init__(self, plan: Plan, seen: list[str]) -> None:
        self._plan, self.requests, self.number = plan, Requests(), 0
        self.tallies = {topic: Tally() for topic in seen}
        self._milestones = [("heard", 1), *([("arrived", plan["count"])] if plan.get("until_last") else [])]

    def check(self) -> None:
        """Report a milestone if it is reached."""
        if self._milestones and all(tally.last >= self._milestones[0][1] for tally in self.tallies.values()):
            reply(**{self._milestones.pop(0)[0]: True})

    def send(self, publish: Callable[[int], None]) -> bool:
        """Publish the next message if it may be sent; report the last; return whether it was sent."""
        allowed = self.requests.allowed(self.number + 1, self._plan["count"])
        if allowed:
            self.number += 1
            publish(self.number)
            if self.number == self._plan["count"]:
                reply(sent=self.number)
        return allowed

    def report(self, lost: dict[str, int], **more: int) -> None:
        """Report what was seen and sent."""
        seen = {topic: asdict(tally) for topic, tally in self.tallies.items()}
        reply(seen=seen, sent=self.number, lost=lost, **more)


def ros(plan: Plan) -> None:
    """Publish on some topics and subscribe to others, over ROS, at a fixed rate."""
    wire, _ = patterns(plan.get("distro", "jazzy"), plan.get("image", 0))
    load = Load(plan, names("out", plan.get("outs", plan["topics"])))
    kind = IMAGE if plan.get("image") else TYPE
    qos = Qos(reliability="reliable", durability="volatile", depth=plan["qos_depth"])
    backend = connect(plan, "load")
    for index, (topic, tally) in enumerate(load.tallies.items()):
        backend.subscribe(topic, kind, qos, tally.receiver(wire(index)))
    topics = enumerate(names("in", plan.get("ins", plan["topics"])))
    out = [(backend.advertise(topic, kind, qos), wire(index)) for index, topic in topics]
    while not load.requests.ended and any(not one.matched for one in backend.status()):
        time.sleep(0.05)
    reply(ready=True)
    load.requests.wait()
    refused = 0

    def publish(number: int) -> None:
        nonlocal refused
        refused += sum(not publisher.write(bytes(pattern.of(number))) for publisher, pattern in out)

    for _ in load.requests.paced(1 / plan["rate"]):
        load.check()
        load.send(publish)
    load.report({one.topic: one.dropped for one in backend.status()}, refused=refused)
    backend.close()


def plc(plan: Plan) -> None:
    """Be the PLC: each scan takes all that is new and sends ``per_scan`` messages on each topic."""
    _, records = patterns(plan.get("distro", "jazzy"), plan.get("image", 0))
    load = Load(plan, names("in", plan.get("ins", plan["topics"])))
    attached = partial(attach, Namespace(plan["prefix"]), write=True)
    ins = [
        (attached(topic, direction=Direction.TO_PLC).reader("load", observe=False), tally, records(index))
        for index, (topic, tally) in enumerate(load.tallies.items())
    ]
    ends = {
        topic: attached(topic, direction=Direction.TO_ROS)
        for topic in names("out", plan.get("outs", plan["topics"]))
    }
    outs = [(end.writer(beat_ms=5000), records(index)) for index, end in enumerate(ends.values())]
    record = bytearray(len(records(0).bytes))
    reply(ready=True)

    def take() -> None:
        for reader, tally, pattern in ins:
            while reader.next(record) is not None:
                tally.add(record, pattern)

    def publish(number: int) -> None:
        for writer, pattern in outs:
            writer.publish(pattern.of(number))

    for scan in load.requests.paced(plan["per_scan"] / plan["rate"]):
        if scan % 100 == 99:  # no scan is longer than 20 ms, and the writers promise a beat in 5 s
            for writer, _ in outs:
                writer.beat()
        take()
        load.check()
        for _ in range(plan["per_scan"]):
            if not load.send(publish):
                break
    take()
    lost = {topic: reader.lost for topic, (reader, _, _) in zip(load.tallies, ins, strict=True)}
    load.report(lost | {topic: end.snapshot().readers[0].lost for topic, end in ends.items()})


def feeder(plan: Plan) -> None:
    """Be the bridge: publish on channels of its own, in turns of a millisecond."""
    layout = compute_layout(TypeStore.bundled("jazzy"), TYPE, Limits(string=STRING))
    _, records = patterns()
    requests = Requests()
    namespace, size, slots = Namespace(plan["prefix"]), layout.size, plan["slots"]
    owned = []
    for index, topic in enumerate(names("in", plan["topics"])):
        about = description_of(layout, topic, Direction.TO_PLC, bridge="feeder")
        channel = OwnedChannel.open(namespace, about, record_size=size, slots=slots)
        owned.append((channel, channel.writer(), records(index)))
    reply(ready=True)
    requests.wait()
    number, began = 0, time.monotonic()
    for _ in requests.paced(0.001):
        while number < (time.monotonic() - began) * plan["rate"] and number < plan["count"]:
            number += 1
            for _, writer, pattern in owned:
                writer.publish(pattern.of(number))
        if number == plan["count"]:
            break
    reply(sent=number, seconds=time.monotonic() - began)
    threading.Event().wait()  # the channels stay until their reader has read them


# Latency and rates


def source(plan: Plan) -> None:
    """Send by turns: ``in``/``out RATE COUNT`` for latency, ``flood TOPIC RATE COUNT`` for rates."""
    wire, records = patterns(plan["distro"])
    on_wire, in_record = stamp_places(plan["distro"])
    message, record = wire(0).of(0), records(0).of(0)
    backend = connect(plan, "source")
    publishers = {topic: backend.advertise(topic, TYPE, QOS) for topic in (BARE, TO_PLC, EVERY)}
    attached = attach(Namespace(plan["prefix"]), TO_ROS, direction=Direction.TO_ROS, write=True)
    writer = attached.writer(beat_ms=60_000)
    wait_for_match(*publishers.values())
    reply(ready=True)

    def send(topic: str) -> None:
        stamp(message, on_wire)
        publishers[topic].write(bytes(message))

    def through_memory() -> None:
        stamp(record, in_record)
        writer.publish(record)

    for line in sys.stdin:
        kind, *rest = line.split()
        if kind == "flood":
            reply(took=_flood(publishers[rest[0]], bytes(message), float(rest[1]), int(rest[2])))
            continue
        for half in paced(0.5 / float(rest[0]), range(2 * int(rest[1]))):
            if half % 2 == 0:
                send(BARE)
            elif kind == "in":
                send(TO_PLC)
            else:
                through_memory()
        reply(sent=int(rest[1]))
    backend.close()


def _flood(publisher: Any, payload: bytes, rate: float, count: int) -> float:
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


def subscriber(plan: Plan) -> None:
    """Receive without a bridge; an empty line asks for the ages since the last one.

    Over DDS nothing but the cyclonedds wheel receives, in a WaitSet; DDS' own stamp, which the bridge sets
    when it has taken a message from shared memory, tells how long that message had waited there.
    """
    at, _ = stamp_places(plan["distro"])
    ages: dict[str, list[float]] = {BARE: [], TO_ROS: [], SENT: []}
    requests = Requests()

    def report() -> None:
        if requests.asked():
            found = {topic: values[:] for topic, values in ages.items()}
            for topic, values in found.items():
                del ages[topic][: len(values)]
            reply(ages=found)

    if plan["backend"] == "dds":
        _subscribe_plainly(plan, ages, requests, report)
        return
    backend = connect(plan, "subscriber")
    for topic in (BARE, TO_ROS):
        backend.subscribe(topic, TYPE, QOS, lambda data, _, t=topic: ages[t].append(age_us(data, at)))  # type: ignore[misc]
    reply(ready=True)
    while not requests.ended:
        time.sleep(0.02)
        report()
    backend.close()


def _subscribe_plainly(
    plan: Plan, ages: dict[str, list[float]], requests: Requests, report: Callable[[], None]
) -> None:
    from cyclonedds._clayer import ddspy_take
    from cyclonedds.core import InstanceState, ReadCondition, SampleState, ViewState, WaitSet
    from cyclonedds.domain import Domain, DomainParticipant
    from cyclonedds.sub import DataReader
    from cyclonedds.topic import Topic
    from cyclonedds.util import duration

    from rosplc.ros.dds.backend import dds_qos, domain_config
    from rosplc.ros.dds.idl import IdlTypes, dds_topic

    domain = Domain(plan["domain"], domain_config(os.environ, plan["distro"]))
    participant = DomainParticipant(plan["domain"])
    kind = IdlTypes(TypeStore.bundled(plan["distro"]))[TYPE]
    waitset = WaitSet(participant)
    anything = SampleState.Any | ViewState.Any | InstanceState.Any
    readers = {}
    for topic in (BARE, TO_ROS):
        reader = DataReader(participant, Topic(participant, dds_topic(topic), kind), dds_qos(QOS, ""))
        condition = ReadCondition(reader, anything)
        waitset.attach(condition)
        readers[topic] = (reader, condition)
    reply(ready=True)
    while not requests.ended:
        waitset.wait(duration(milliseconds=100))
        for topic, (reader, _) in readers.items():
            for data, info in ddspy_take(reader._ref, int(anything), 100):
                if info.valid_data:
                    ages[topic].append(age_us(data, 4))
                    if topic == TO_ROS:
                        ages[SENT].append((time.time_ns() - info.source_timestamp) / 1000)
        report()
    del domain


def by_turns(plan: Plan) -> None:
    """Send ``RATE COUNT`` messages on each topic of ``turns``, by turns."""
    wire, _ = patterns(plan["distro"])
    at, message, backend = stamp_places(plan["distro"])[0], wire(0).of(0), connect(plan, "source")
    publishers = [backend.advertise(topic, TYPE, QOS) for topic in plan["turns"]]
    wait_for_match(*publishers)
    reply(ready=True)
    for line in sys.stdin:
        rate, count = line.split()
        for publisher in paced(1 / float(rate) / len(publishers), publishers * int(count)):
            stamp(message, at)
            publisher.write(bytes(message))
        reply(sent=count)
    backend.close()


def spinner(plan: Plan) -> None:
    """Poll records without a pause, as a PLC task on its own core; an empty line asks for the ages."""
    _, at = stamp_places(plan["distro"])
    turns = plan.get("turns") or {TO_PLC: plan["prefix"]}
    ends = {
        topic: attach(Namespace(prefix), topic, direction=Direction.TO_PLC) for topic, prefix in turns.items()
    }
    readers = [(topic, end.reader("spinner")) for topic, end in ends.items()]
    record = bytearray(next(iter(ends.values())).identity.record_size)
    requests = Requests()
    ages: dict[str, list[float]] = {topic: [] for topic in turns}
    reply(ready=True)
    while not requests.ended:
        for topic, reader in readers:
            if reader.latest(record) is not None:
                ages[topic].append(age_us(record, at))
        if requests.asked():
            reply(ages=ages)
            ages = {topic: [] for topic in turns}


def counter(plan: Plan) -> None:
    """Take every record in order, a thousand times a second; an empty line asks how many there were."""
    attached = attach(Namespace(plan["prefix"]), EVERY, direction=Direction.TO_PLC, write=True)
    reader = attached.reader("counter", observe=False)
    record = bytearray(attached.identity.record_size)
    requests = Requests()
    count = 0
    reply(ready=True)
    while not requests.ended:
        time.sleep(0.001)
        while reader.next(record) is not None:
            count += 1
        if requests.asked():
            reply(count=count, lost=reader.lost)
            count = 0


# Real-time settings: a message is the time at which it was sent


def realtime_source(plan: Plan) -> None:
    """Send ``RATE COUNT`` messages to each bridge by turns, with a priority above the bridges'."""
    os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(_SOURCE_PRIORITY))
    backend = connect(plan, "source")
    publishers = [
        backend.advertise(REALTIME_TOPIC.format(name), REALTIME_TYPE, QOS) for name in plan["prefixes"]
    ]
    wait_for_match(*publishers)
    reply(ready=True)
    for line in sys.stdin:
        rate, count = line.split()
        for publisher in paced(1 / float(rate) / len(publishers), publishers * int(count)):
            publisher.write(b"\0\1\0\0" + _TIME.pack(time.monotonic_ns()))
        reply(sent=count)
    backend.close()


def realtime_plc(plan: Plan) -> None:
    """Scan every bridge's object each millisecond; an empty line asks for the ages in µs, and for the scans'.

    A scan's is how late it begins, and how long it takes.
    """
    os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(_PLC_PRIORITY))
    gc.disable()
    readers = {}
    for name, prefix in plan["prefixes"].items():
        channel = attach(Namespace(prefix), REALTIME_TOPIC.format(name), direction=Direction.TO_PLC)
        readers[name] = channel, channel.reader("plc")
    out = bytearray(8)
    requests = Requests()
    ages: dict[str, list[float]] = {name: [] for name in (*readers, "late", "scan")}
    reply(ready=True)
    due = time.monotonic_ns()
    while not requests.ended:
        began = time.monotonic_ns()
        for name, (_, reader) in readers.items():
            while reader.next(out) is not None:
                ages[name].append((time.monotonic_ns() - _TIME.unpack(out)[0]) / 1000)
        ages["late"].append((began - due) / 1000)
        ages["scan"].append((time.monotonic_ns() - began) / 1000)
        if requests.asked():
            reply(ages=ages)
            ages = {name: [] for name in ages}
        due = max(due + int(1e9 * _REALTIME_SCAN_S), began)
        time.sleep(max(0, due - time.monotonic_ns()) / 1e9)


# Classic memory beside a channel


def classic_plc(plan: Plan) -> None:
    """Be the PLC of both; requests are JSON: ``do: read`` or ``do: write``."""
    reply(ready=True)
    for line in sys.stdin:
        request = json.loads(line)
        do = _classic_read if request["do"] == "read" else _classic_write
        do(request, plan["prefix"], plan["size"])


def _classic(name: str, size: int) -> ClassicObject:
    made = ClassicObject(name, name, size, write=True, recover_after_ns=10**12)
    made.attach()
    return made


def _enter(memory: ClassicObject) -> None:
    """Take the lock, however long that takes."""
    while memory.enter(0) is not Entry.ENTERED:
        pass


def _classic_read(request: Plan, prefix: str, size: int) -> None:
    """Gather the ages of messages for ``seconds``; each 10 ms stay in the classic lock for ``hold_us``."""
    memory = _classic(f"{prefix}-classic-in0", size)
    ages: dict[str, list[float]] = {"classic": [], "channel": []}
    record = bytearray(size)
    with attach(Namespace(prefix), "/channel/in0", direction=Direction.TO_PLC) as attached:
        reader = attached.reader()
        reader.latest(record)
        last, now = memory.peek()[:8], time.monotonic_ns()
        end, hold_at = now + int(request["seconds"] * 1e9), now
        while (now := time.monotonic_ns()) < end:
            if request["hold_us"] and now >= hold_at:
                _enter(memory)
                time.sleep(request["hold_us"] / 1e6)
                memory.leave()
                hold_at = now + _HOLD_EVERY_NS
            if memory.enter(0) is Entry.ENTERED:
                image = memory.read()
                memory.leave()
                if image is not None and image[:8] != last:
                    last = image[:8]
                    ages["classic"].append((time.monotonic_ns() - _TIME.unpack(last)[0]) / 1000)
            if reader.latest(record) is not None:
                ages["channel"].append((time.monotonic_ns() - _TIME.unpack_from(record)[0]) / 1000)
            time.sleep(_CLASSIC_SCAN_S)
    memory.close()
    reply(ages=ages)


def _classic_write(request: Plan, prefix: str, size: int) -> None:
    """Write stamped messages at a rate into the first memories or channels."""

    def locked(memory: ClassicObject, record: bytes) -> None:
        _enter(memory)
        memory.write(record)
        if request["hold_us"]:
            time.sleep(request["hold_us"] / 1e6)
        memory.leave()

    with ExitStack() as stack:
        sends: list[Callable[[bytes], object]] = []
        for number in range(request["topics"]):
            if request["kind"] == "classic":
                memory = _classic(f"{prefix}-classic-out{number}", size)
                stack.callback(memory.close)
                sends.append(partial(locked, memory))
            else:
                topic = f"/channel/out{number}"
                attached = attach(Namespace(prefix), topic, direction=Direction.TO_ROS, write=True)
                stack.callback(attached.close)
                sends.append(attached.writer(60_000).publish)
        for _ in paced(1 / request["rate"], range(request["count"])):
            for send in sends:
                send(_TIME.pack(time.monotonic_ns()) + bytes(size - 8))
    reply(written=request["count"] * request["topics"])


def answerer(plan: Plan) -> None:
    """Serve each service of ``bare`` over the backend, and those of ``rclpy`` with nothing of rosplc's."""
    backend = connect(plan, "answerer")

    def serve(service: str) -> None:
        server = backend.serve(service, plan["type"], SERVICES, lambda *call: server.reply(call[1], answer))

    answer = bytes.fromhex(plan["response"])
    for service in plan["bare"]:
        serve(service)
    if plan["rclpy"]:
        _serve_plainly(plan)
    reply(ready=True)
    sys.stdin.read()
    os._exit(0)


def _serve_plainly(plan: Plan) -> None:
    """Serve with rclpy alone, as a node of any package does."""
    import rclpy
    from rclpy.serialization import deserialize_message
    from std_srvs.srv import SetBool

    context = rclpy.Context()
    context.init(domain_id=plan["domain"])
    node = rclpy.create_node("plain", context=context)
    response = deserialize_message(bytes.fromhex(plan["response"]), SetBool.Response)
    for service in plan["rclpy"]:
        node.create_service(SetBool, service, lambda *_: response)
    executor = rclpy.executors.SingleThreadedExecutor(context=context)
    executor.add_node(node)
    threading.Thread(target=executor.spin, daemon=True).start()


def plain(plan: Plan) -> None:
    """Be a node of a user's own, of rclpy alone; an empty line asks how many messages it has received.

    With ``copies`` in the plan it copies the fields of what it receives into objects and looks every
    millisecond for records to publish; without, its callbacks only count.
    """
    import rclpy
    from geometry_msgs.msg import PoseStamped

    layout = compute_layout(TypeStore.bundled(plan["distro"]), TYPE, Limits(string=STRING))
    record = struct.Struct(f"<iI{STRING + 1}s7d")
    context = rclpy.Context()
    context.init(domain_id=plan["domain"])
    node = rclpy.create_node("plain", context=context)
    profile = rclpy.qos.QoSProfile(depth=plan["qos_depth"])
    received = 0

    def owned(topic: str, direction: Direction) -> OwnedChannel:
        about = description_of(layout, topic, direction, bridge="plain")
        return OwnedChannel.open(Namespace(plan["prefix"]), about, record_size=layout.size, slots=4096)

    def subscribe(topic: str) -> None:
        def copy(message: Any) -> None:
            nonlocal received
            received += 1
            stamp, at, to = message.header.stamp, message.pose.position, message.pose.orientation
            text = message.header.frame_id.encode()
            writer.publish(
                record.pack(stamp.sec, stamp.nanosec, text, at.x, at.y, at.z, to.x, to.y, to.z, to.w)
            )

        def count(_message: Any) -> None:
            nonlocal received
            received += 1

        if plan["copies"]:
            writer = owned(topic, Direction.TO_PLC).writer(60_000)
        node.create_subscription(PoseStamped, topic, copy if plan["copies"] else count, profile)

    for topic in names("in", plan["topics"]):
        subscribe(topic)
    outs = [
        (owned(topic, Direction.TO_ROS).reader(60_000), node.create_publisher(PoseStamped, topic, profile))
        for topic in names("out", plan["outs"])
    ]
    taken = bytearray(layout.size)

    def look() -> None:
        for reader, publisher in outs:
            while reader.next(taken) is not None:
                message = PoseStamped()
                header, at, to = message.header, message.pose.position, message.pose.orientation
                header.stamp.sec, header.stamp.nanosec, text, *pose = record.unpack(taken)
                header.frame_id = text.rstrip(b"\0").decode()
                at.x, at.y, at.z, to.x, to.y, to.z, to.w = pose
                publisher.publish(message)

    if outs:
        node.create_timer(0.001, look)
    executor = rclpy.executors.SingleThreadedExecutor(context=context)
    executor.add_node(node)
    threading.Thread(target=executor.spin, daemon=True).start()
    reply(ready=True)
    for _ in sys.stdin:
        reply(count=received)
    os._exit(0)


def service_plc(plan: Plan) -> None:
    """Answer calls with a block per service, each in a task with the scan interval that the plan gives."""
    for service, seconds in plan["blocks"].items():
        block, task = ServiceServer(service, prefix=plan["prefix"]), Task(service, seconds)

        def scan(block: ServiceServer = block) -> None:
            block.xReply = block() and not block.xReply

        task.program(scan)
        task.start()
    reply(ready=True)
    sys.stdin.read()
    os._exit(0)


def page(plan: Plan) -> None:
    """Be an open page of `rosplc web`: ask for the overview, a message and plots, and read every frame."""
    import aiohttp

    async def look() -> None:
        url, one = plan["url"], plan["channel"]
        async with (
            aiohttp.ClientSession() as session,
            session.ws_connect(url + "api/live", origin=url.rstrip("/")) as socket,
        ):
            await socket.send_json({"wants": {"messages": [one], "plots": {one: ["pose.position.x"]}}})
            await socket.receive_json()
            reply(ready=True)
            async for message in socket:
                json.loads(message.data)

    threading.Thread(target=lambda: (sys.stdin.read(), os._exit(0)), daemon=True).start()
    asyncio.run(look())


ROLES = {
    each.__name__: each
    for each in (
        *(ros, plc, feeder, source, by_turns, subscriber, spinner, counter, page),
        *(realtime_source, realtime_plc, classic_plc, answerer, service_plc, plain),
    )
}

if __name__ == "__main__":
    ROLES[sys.argv[1]](json.loads(sys.argv[2]))
