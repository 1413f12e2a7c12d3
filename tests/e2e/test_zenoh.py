"""The whole way on Zenoh: a robot on an independent implementation, a router, a bridge, and a PLC."""

from __future__ import annotations

import os
import time
from collections.abc import Iterator
from contextlib import ExitStack
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("zenoh")
pytest.importorskip("zenoh_ros2_sdk")

from tests.e2e.cell import Bridge, Plc
from tests.interop.zenoh.processes import Router, free_port
from tests.interop.zenoh.sdk import SdkInbox, SdkOutbox, SdkPeer

pytestmark = [
    pytest.mark.timeout(120),
    pytest.mark.foreign,
    pytest.mark.verifies("zenoh", real="eclipse-zenoh"),
]

DOMAIN = 17
PARAMETER, STATE = "rcl_interfaces/msg/ParameterValue", "cell_msgs/msg/State"
# As the robot knows them; the bridge has the first one from its distribution, the other from a folder.
DEFINITIONS = {
    PARAMETER: (
        "uint8 type\nbool bool_value\nint64 integer_value\nfloat64 double_value\nstring string_value\n"
        "byte[] byte_array_value\nbool[] bool_array_value\nint64[] integer_array_value\n"
        "float64[] double_array_value\nstring[] string_array_value\n"
    ),
    STATE: "int32 number\nfloat64[] values\nstring name\nbool[3] flags\nuint8[] raw\n",
}


def parameter(i: int) -> dict[str, Any]:
    """Return the fields of the message with this number; every field changes with it."""
    return {
        "type": i % 256,
        "bool_value": i % 2 == 1,
        "integer_value": -(2**62) - i,
        "double_value": i / 7,
        "string_value": f"Ölkännchen {i}",
        "byte_array_value": [i % 128] * (i % 5),  # the robot's library shows larger ones as negative
        "bool_array_value": [bool(i >> bit & 1) for bit in range(10)],
        "integer_array_value": [i, -i, 2**63 - 1 - i],
        "double_array_value": [i / 3, 1e300, -1e-300],
        "string_array_value": ["", f"part {i}", "x" * (i % 30)],
    }


def state(i: int) -> dict[str, Any]:
    """Return the fields of the message with this number."""
    return {
        "number": -i,
        "values": [i / 9] * (i % 4 + 1),
        "name": f"state {i}",
        "flags": [i % 2 == 0, i % 3 == 0, i % 5 == 0],
        "raw": [i % 256, 255, 0],
    }


MAKE = {PARAMETER: parameter, STATE: state}
TO_PLC = {"/parameter": PARAMETER, "/state": STATE}
TO_ROS = {"/parameter_of_plc": PARAMETER, "/state_of_plc": STATE}


def fill(message: Any, fields: dict[str, Any]) -> None:
    for name, value in fields.items():
        setattr(message, name, value)


@dataclass
class Stream:
    """One topic's messages, from the one side to the other: what was sent, and what has come."""

    send: Any
    make: Any
    came: list[dict[str, Any]]
    sent: list[dict[str, Any]] = field(default_factory=list)
    repeated: int = 0

    def next(self) -> dict[str, Any]:
        """Send a message that was not sent before."""
        message = self.make(len(self.sent))
        self.sent.append(message)
        self.send(message)
        return message  # type: ignore[no-any-return]

    def repeat(self, message: dict[str, Any]) -> None:
        """Send one again, which may be lost."""
        self.repeated += 1
        self.send(message)

    def has(self, message: dict[str, Any]) -> bool:
        """Whether a message that was sent of late has come."""
        return message in self.came[-100:]

    def numbers(self) -> list[int]:
        """Return the numbers of the messages that came, in order; each must be one that was sent, whole."""
        numbers = [self.sent.index(message) for message in self.came]
        once = list(dict.fromkeys(numbers))
        assert len(numbers) - len(once) <= self.repeated
        return once


class Cell:
    """A router, a bridge, its PLC, and a robot on zenoh-ros2-sdk."""

    def __init__(self, stack: ExitStack, mode: str, folder: Path, prefix: str) -> None:
        self.router = stack.enter_context(Router(stack.enter_context(free_port())))
        messages = folder / "cell_msgs" / "msg"
        messages.mkdir(parents=True)
        (messages / "State.msg").write_text(DEFINITIONS[STATE])
        path = folder / "cell.yaml"
        path.write_text(
            f"bridge: {prefix}\nprefix: {prefix}\n"
            f"ros:\n  {{backend: zenoh, distro: jazzy, node_name: {prefix}, domain: {DOMAIN},\n"
            f"   zenoh: {{mode: {mode}, connect: [{self.router.endpoint}]}}}}\n"
            f"types: {{paths: [{folder}]}}\ntasks: {{RosTask: {{interval: 5ms}}}}\ntopics:\n"
            + "".join(f"  {topic}: {{type: {kind}, to: plc}}\n" for topic, kind in TO_PLC.items())
            + "".join(f"  {topic}: {{type: {kind}, to: ros}}\n" for topic, kind in TO_ROS.items())
        )
        clean = {name: value for name, value in os.environ.items() if not name.startswith("ZENOH_")}
        self.bridge = Bridge(path, clean)
        stack.callback(self.bridge.kill)
        robot = stack.enter_context(SdkPeer(self.router.port, DOMAIN))
        self.plc = Plc(prefix, TO_PLC, TO_ROS)
        self.streams = {
            topic: self._from_robot(robot.advertise(topic, kind, definition=DEFINITIONS[kind]), topic, kind)
            for topic, kind in TO_PLC.items()
        } | {
            topic: self._to_robot(robot.subscribe(topic, kind, definition=DEFINITIONS[kind]), topic, kind)
            for topic, kind in TO_ROS.items()
        }
        self.plc.until(lambda: self.plc.attached)
        self.plc.until(lambda: all(block.udiSinks == 1 for block in self.plc.writes.values()))
        self.plc.until(lambda: all(block.udiSources == 1 for block in self.plc.reads.values()))

    def _from_robot(self, outbox: SdkOutbox, topic: str, kind: str) -> Stream:
        # Without waiting for a subscriber: while there is no router a robot says what it says to nobody.
        return Stream(lambda message: outbox.publish(message, wait=False), MAKE[kind], self.plc.seen[topic])

    def _to_robot(self, inbox: SdkInbox, topic: str, kind: str) -> Stream:
        def send(fields: dict[str, Any]) -> None:
            self.plc.write(topic, lambda message: fill(message, fields))

        return Stream(send, MAKE[kind], inbox.messages)

    def news_crosses(self) -> None:
        """Send on every topic, until a message that was sent in here has come on each.

        What is sent while links come up goes nowhere, so that there is no message that must come.
        """
        begin = {topic: (len(stream.sent), len(stream.came)) for topic, stream in self.streams.items()}

        def heard(topic: str) -> bool:
            sent, came = begin[topic]
            stream = self.streams[topic]
            return any(message in stream.sent[sent:] for message in stream.came[came:])

        while not all(map(heard, self.streams)):
            for stream in self.streams.values():
                stream.next()
            self.scan_for(0.02)

    def scan_for(self, seconds: float) -> None:
        end = time.monotonic() + seconds
        self.plc.until(lambda: time.monotonic() > end)

    def crosses_once(self, *, repeat_after: float | None) -> None:
        """Send one message on every topic, and wait until each has come.

        Args:
            repeat_after: Seconds after which a message is sent again; None: never.
        """
        awaited = [(stream, stream.next()) for stream in self.streams.values()]
        while missing := [(stream, message) for stream, message in awaited if not stream.has(message)]:
            end = None if repeat_after is None else time.monotonic() + repeat_after
            self.plc.until(
                lambda missing=missing, end=end: (
                    all(stream.has(message) for stream, message in missing)
                    or (end is not None and time.monotonic() > end)
                )
            )
            for stream, message in missing:
                if not stream.has(message):
                    stream.repeat(message)

    def nothing_is_invented(self) -> None:
        """Each message that came is one that was sent, field by field; none came twice or late."""
        for topic, stream in self.streams.items():
            numbers = stream.numbers()
            assert numbers == sorted(numbers), topic

    def stop(self) -> None:
        assert self.bridge.stop() == 0, self.bridge.log.read_text()


@pytest.fixture
def stack() -> Iterator[ExitStack]:
    with ExitStack() as stack:
        yield stack


@pytest.mark.parametrize("mode", ["peer", "client"])
def test_values_cross_between_zenoh_and_the_plc(
    stack: ExitStack, mode: str, tmp_path: Path, shm_prefix: str
) -> None:
    """Every value that a robot on Zenoh sends reaches the PLC, and every one of the PLC's reaches it."""
    cell = Cell(stack, mode, tmp_path, shm_prefix)
    cell.news_crosses()
    begin = {topic: len(stream.sent) for topic, stream in cell.streams.items()}
    for _ in range(50):
        # Peers may still move from the router to a link of their own, and lose what is under way then;
        # a client has no other way than the router, and nothing may be lost on it.
        cell.crosses_once(repeat_after=3 if mode == "peer" else None)
    for topic, stream in cell.streams.items():
        assert stream.numbers()[-50:] == list(range(begin[topic], begin[topic] + 50))
    cell.nothing_is_invented()
    cell.stop()


@pytest.mark.parametrize("mode", ["peer", "client"])
def test_router_dies_amid_the_stream(stack: ExitStack, mode: str, tmp_path: Path, shm_prefix: str) -> None:
    """After the router was killed and started again, messages cross both ways, and none is wrong or old."""
    cell = Cell(stack, mode, tmp_path, shm_prefix)
    cell.news_crosses()
    cell.router.kill()
    log = cell.bridge.log
    while "ROS016" not in log.read_text():  # the stream goes on, to nobody or to the peer
        for stream in cell.streams.values():
            stream.next()
        cell.plc.scan()
    if mode == "peer":
        cell.news_crosses()
    cell.router.start()
    cell.news_crosses()
    cell.nothing_is_invented()
    cell.stop()
