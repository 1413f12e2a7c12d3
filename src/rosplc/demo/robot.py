"""The robot's process: publishes over DDS, obeys the commands that come back.

It is an ordinary ROS 2 participant; nothing here knows of PLCs or shared memory.
"""

from __future__ import annotations

import random
import sys
import threading
import time
from dataclasses import asdict

from rosplc.codec import Codec, Wire
from rosplc.demo.plan import COMMAND, SECOND_NS, Plan, Tally, Turtle, open_command, robot_topics
from rosplc.demo.processes import Commands, report
from rosplc.errors import RosplcError
from rosplc.layout import Limits, compute_layout
from rosplc.model import TypeStore
from rosplc.ros import Qos, open_backend

_STATUS_SECONDS = 0.1
_SENDS = Qos(reliability="reliable", durability="volatile", depth=1000)
# The bridge latches what it sends, so a bridge that was restarted still hands over the commands
# that the PLC gave meanwhile.
_OBEYS = Qos(reliability="reliable", durability="transient_local", depth=1000)
_DITHER = 0.1


class Robot:
    """The turtle with its DDS endpoints."""

    def __init__(self, plan: Plan) -> None:
        self._plan = plan
        self._turtle = Turtle()
        self._lock = threading.Lock()
        self._tally = Tally()
        store = TypeStore.bundled(plan.distro)
        self._topics = robot_topics(plan.topics)
        self._codecs = {
            kind.type_name: Codec(compute_layout(store, kind.type_name, Limits(sequence=64)), Wire.CDR)
            for kind in self._topics.values()
        }
        self._sent = dict.fromkeys(self._topics, 0)
        topic, type_name = COMMAND
        self._command_layout = compute_layout(store, type_name, Limits())
        self._command_codec = Codec(self._command_layout, Wire.CDR)
        self._backend = open_backend("dds", store, "turtle", domain=plan.domain)
        self._publishers = {
            name: self._backend.advertise(name, kind.type_name, _SENDS) for name, kind in self._topics.items()
        }
        self._subscription = self._backend.subscribe(topic, type_name, _OBEYS, self._on_command)

    def _on_command(self, payload: bytes, stamp_ns: int) -> None:
        message = self._command_layout.view(self._command_codec.decode(payload))
        opened = open_command(message)
        with self._lock:
            self._tally.add(opened.number, whole=opened.whole)
            if opened.whole:
                self._turtle.obey(message.linear.x, message.angular.z)

    def unmatched(self) -> dict[str, str]:
        """Return the topics without a peer, each with the reason that the backend gives."""
        return {
            status.topic: status.reason or "no peer yet"
            for status in self._backend.status()
            if status.matched == 0
        }

    def tick(self, seconds: float) -> None:
        """Move on by ``seconds`` and publish every topic once."""
        stamp_ns = time.time_ns()
        with self._lock:
            self._turtle.move(seconds)
            contents = {name: self._turtle.contents(kind.name) for name, kind in self._topics.items()}
        for name, kind in self._topics.items():
            number = self._sent[name] + 1
            codec = self._codecs[kind.type_name]
            record = codec.layout.pack(kind.seal(contents[name], number, stamp_ns))
            if self._publishers[name].write(codec.encode(record), stamp_ns):
                self._sent[name] = number

    def status(self) -> dict[str, object]:
        """Return what the parent shows and compares."""
        with self._lock:
            return {
                "sent": dict(self._sent),
                "received": {COMMAND[0]: asdict(self._tally)},
                "metres": self._turtle.way,
                "unmatched": self.unmatched(),
            }

    def close(self) -> None:
        """Leave the graph."""
        self._backend.close()


def main() -> None:
    """Run the robot until told to stop."""
    commands = Commands()
    plan = Plan.from_json(sys.argv[1])
    try:
        robot = Robot(plan)
    except RosplcError as error:
        report("error", **error.to_dict())
        sys.exit(1)
    try:
        _drive(robot, plan, commands)
        report("status", **robot.status())
    finally:
        robot.close()


def _drive(robot: Robot, plan: Plan, commands: Commands) -> None:
    period = round(SECOND_NS / plan.rate)
    due = time.monotonic_ns()
    reported = 0.0
    while not commands.stop.is_set():
        if commands.go.is_set() and not commands.drain.is_set():
            robot.tick(period / SECOND_NS)
            # Two clocks of one machine would keep one phase for a whole run, and the age at the PLC
            # would depend on the moment of the start. A robot's own clock wanders against the PLC's.
            step = period * random.uniform(1 - _DITHER, 1 + _DITHER)
            due = max(due + round(step), time.monotonic_ns() - SECOND_NS // 10)
        else:
            due = time.monotonic_ns() + 10_000_000
        if time.monotonic() - reported >= _STATUS_SECONDS:
            reported = time.monotonic()
            report("status", drained=commands.drain.is_set(), **robot.status())
        commands.stop.wait(max(0, due - time.monotonic_ns()) / SECOND_NS)


if __name__ == "__main__":
    main()
