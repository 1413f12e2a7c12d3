"""Both ends of a bridge under load, as processes of their own; every message is checked.

    python -m benchmarks.load_peers ros|plc ORDERS_JSON

``ros`` publishes on some topics and subscribes to others, ``plc`` does the same through shared
memory, both at a fixed rate. A message carries its number and its topic's, and everything in it
follows from both, so that a receiver knows each byte that must come. ``go`` on standard input
sends the first message of each topic and ``more`` the others, at the rate; a line of JSON says when a
peer is ready, when it has heard a first message on each topic (from there on readers count losses), when it
has sent everything, and, after ``stop``, what it saw.
"""

from __future__ import annotations

import json
import struct
import sys
import threading
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass
from typing import Any

from rosplc.codec import Codec, Wire
from rosplc.layout import Limits, compute_layout
from rosplc.model import TypeStore
from rosplc.ros import ROS1, Backend, Qos, open_backend
from rosplc.shm import Direction, Namespace, attach

TYPE = "geometry_msgs/msg/PoseStamped"
STRING = 119  # the longest frame_id; with it a message has about 200 bytes
_FRAME = "f" * STRING
_POSE = struct.Struct("<7d")
_NUMBER = struct.Struct("<i")


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
    """Return where the stamp stands on the wire (after CDR's header or ROS 1's seq) and in the record."""
    return 4, 4 if distro == ROS1 else 0


def patterns(distro: str = "jazzy") -> tuple[Callable[[int], Pattern], Callable[[int], Pattern]]:
    """Return how messages of a topic look on the wire, and how as records."""
    layout = compute_layout(TypeStore.bundled(distro), TYPE, Limits(string=STRING))
    codec = Codec(layout, Wire.ROS1 if distro == ROS1 else Wire.CDR)
    record = bytes(codec.layout.pack({"header": {"frame_id": _FRAME}}))
    wire = codec.encode(record)
    on_wire, in_record = stamp_places(distro)
    return (lambda topic: Pattern(wire, on_wire, topic)), (lambda topic: Pattern(record, in_record, topic))


def join(order: dict[str, Any], name: str) -> Backend:
    """Join the graph that the order names: by default ROS 2 over DDS."""
    store = TypeStore.bundled(order.get("distro", "jazzy"))
    return open_backend(
        order.get("backend", "dds"), store, name, domain=order.get("domain"), options=order.get("options")
    )


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


def say(**facts: Any) -> None:
    """Report to whoever started this process."""
    print(json.dumps(facts), flush=True)


class Orders:
    """What comes on standard input."""

    def __init__(self) -> None:
        self.go, self.more, self.stop = threading.Event(), threading.Event(), threading.Event()
        threading.Thread(target=self._read, daemon=True).start()

    def _read(self) -> None:
        words = {"go": self.go, "more": self.more}
        for line in sys.stdin:
            if (event := words.get(line.strip())) is None:
                break
            event.set()
        self.stop.set()
        self.go.set()

    def allowed(self, number: int, count: int) -> bool:
        """Return whether message ``number`` may be sent."""
        return number <= count and (self.more.is_set() or (number == 1 and self.go.is_set()))


class Ears:
    """Says once that every topic has been heard."""

    def __init__(self, tallies: dict[str, Tally]) -> None:
        self._tallies, self._said = tallies, False

    def listen(self) -> None:
        """Look whether it is time to say so."""
        if not self._said and all(tally.received for tally in self._tallies.values()):
            self._said = True
            say(heard=True)


def paced(period: float, orders: Orders, body: Callable[[], None]) -> None:
    """Run ``body`` every ``period`` seconds until told to stop; late turns are made up for."""
    due = time.monotonic()
    while not orders.stop.is_set():
        body()
        due += period
        time.sleep(max(0.0, due - time.monotonic()))


def ros(order: dict[str, Any]) -> None:
    """Be the ROS side."""
    wire, _ = patterns(order.get("distro", "jazzy"))
    orders = Orders()
    qos = Qos(reliability="reliable", durability="volatile", depth=order["qos_depth"])
    backend = join(order, "load")
    tallies = {topic: Tally() for topic in names("out", order["topics"])}
    for index, topic in enumerate(tallies):
        tally, pattern = tallies[topic], wire(index)
        backend.subscribe(topic, TYPE, qos, lambda data, _, t=tally, p=pattern: t.add(data, p))  # type: ignore[misc]
    out = [
        (backend.advertise(topic, TYPE, qos), wire(index))
        for index, topic in enumerate(names("in", order["topics"]))
    ]
    while not orders.stop.is_set() and any(not one.matched for one in backend.status()):
        time.sleep(0.05)
    say(ready=True)
    orders.go.wait()
    number, refused, ears = 0, 0, Ears(tallies)

    def turn() -> None:
        nonlocal number, refused
        ears.listen()
        if orders.allowed(number + 1, order["count"]):
            number += 1
            for publisher, pattern in out:
                refused += not publisher.write(bytes(pattern.of(number)))
            if number == order["count"]:
                say(sent=number)

    paced(1 / order["rate"], orders, turn)
    lost = {one.topic: one.dropped for one in backend.status()}
    seen = {topic: asdict(tally) for topic, tally in tallies.items()}
    say(seen=seen, sent=number, refused=refused, lost=lost)
    backend.close()


def plc(order: dict[str, Any]) -> None:
    """Be the PLC: each scan takes all that is new and sends ``per_scan`` messages on each topic."""
    _, records = patterns(order.get("distro", "jazzy"))
    orders = Orders()
    namespace = Namespace(order["prefix"])
    tallies = {topic: Tally() for topic in names("in", order["topics"])}
    ins, outs = [], []
    for index, topic in enumerate(tallies):
        attached = attach(namespace, topic, direction=Direction.TO_PLC, write=True)
        ins.append((attached.reader("load", observe=False), tallies[topic], records(index)))
    ends = [
        attach(namespace, topic, direction=Direction.TO_ROS, write=True)
        for topic in names("out", order["topics"])
    ]
    for index, attached in enumerate(ends):
        outs.append((attached.writer(beat_ms=5000), records(index)))
    record = bytearray(len(records(0).bytes))
    say(ready=True)
    number, ears, scans = 0, Ears(tallies), 0

    def scan() -> None:
        nonlocal number, scans
        scans += 1
        if scans % 100 == 0:  # no scan is longer than 20 ms, and the writers promise a beat in 5 s
            for writer, _ in outs:
                writer.beat()
        for reader, tally, pattern in ins:
            while reader.next(record) is not None:
                tally.add(record, pattern)
        ears.listen()
        for _ in range(order["per_scan"]):
            if not orders.allowed(number + 1, order["count"]):
                break
            number += 1
            for writer, pattern in outs:
                writer.publish(pattern.of(number))
            if number == order["count"]:
                say(sent=number)

    paced(order["per_scan"] / order["rate"], orders, scan)
    for reader, tally, pattern in ins:
        while reader.next(record) is not None:
            tally.add(record, pattern)
    lost = {topic: reader.lost for topic, (reader, _, _) in zip(tallies, ins, strict=True)}
    lost |= {
        topic: end.snapshot().readers[0].lost
        for topic, end in zip(names("out", order["topics"]), ends, strict=True)
    }
    say(seen={topic: asdict(tally) for topic, tally in tallies.items()}, sent=number, lost=lost)


if __name__ == "__main__":
    {"ros": ros, "plc": plc}[sys.argv[1]](json.loads(sys.argv[2]))
