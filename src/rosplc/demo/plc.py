"""The virtual PLC's process: takes the robot's messages, steers it, knows nothing of ROS.

The task, and what is kept of messages, it shares with the processes that run Structured Text.
"""

from __future__ import annotations

import math
import sys
import threading
import time
from collections import deque
from collections.abc import Callable, Iterable
from dataclasses import asdict
from statistics import median, quantiles
from typing import Any

from rosplc.demo.plan import COMMAND, Opened, Plan, Tally, command, robot_topics, steer
from rosplc.demo.processes import Commands, report
from rosplc.virtual_plc import CycleStats, ReadBlock, VirtualPlc, WriteBlock

_STATUS_SECONDS = 0.1
_AGES_KEPT = 200_000


class Arrivals:
    """What came, per topic: counted in ``tallies``, and how old it was."""

    def __init__(self, topics: Iterable[str]) -> None:
        self.tallies = {topic: Tally() for topic in topics}
        self._ages: dict[str, deque[int]] = {topic: deque(maxlen=_AGES_KEPT) for topic in self.tallies}

    def add(self, topic: str, opened: Opened, now_ns: int) -> None:
        """Count a message that the program had in hand at ``now_ns`` (ns since 1970)."""
        self.tallies[topic].add(opened.number, whole=opened.whole)
        if opened.whole:
            self._ages[topic].append(now_ns - opened.stamp_ns)

    def summary(self) -> dict[str, dict[str, float]]:
        """Return median and p99 age in milliseconds, per topic and over all (``""``)."""
        ages = {topic: list(values) for topic, values in self._ages.items()}
        ages[""] = [age for values in list(ages.values()) for age in values]
        found = {}
        for topic, values in ages.items():
            if values:
                p99 = quantiles(values, n=100, method="inclusive")[98] if len(values) > 1 else values[0]
                found[topic] = {"median_ms": median(values) / 1e6, "p99_ms": p99 / 1e6}
        return found

    def recent(self) -> dict[str, float]:
        """Return the age in milliseconds of each topic's last message."""
        return {topic: values[-1] / 1e6 for topic, values in self._ages.items() if values}


def serve(
    program: Callable[[], None],
    interval: float,
    commands: Commands,
    facts: Callable[[CycleStats], dict[str, Any]],
) -> CycleStats:
    """Run ``program`` every ``interval`` seconds and report until told to stop; return the statistics.

    Raises what the program raised.
    """
    plc = VirtualPlc()
    task = plc.task("RosTask", interval, priority=4)
    task.program(program)
    with plc:
        while not commands.stop.wait(_STATUS_SECONDS):
            plc.check()
            report("status", **facts(task.stats))
    return task.stats


def serve_demo(
    program: Callable[[], None],
    interval: float,
    commands: Commands,
    arrivals: Arrivals,
    facts: Callable[[], dict[str, Any]],
) -> None:
    """Run a program of the demonstration; its last report has the ages of all messages."""

    def shown(stats: CycleStats) -> dict[str, Any]:
        return {"cycle": stats.to_dict(), "age": arrivals.recent(), **facts()}

    stats = serve(program, interval, commands, shown)
    report("status", **shown(stats), ages=arrivals.summary())


class PythonProgram:
    """The PLC program: reads every topic, computes the command from the pose."""

    def __init__(self, plan: Plan, commands: Commands) -> None:
        self._commands = commands
        self._kinds = robot_topics(plan.topics)
        how: dict[str, Any] = {"mode": "every", "max_per_cycle": plan.per_scan, "stale_after": 0.5}
        self.reads = {topic: ReadBlock(topic, prefix=plan.prefix, **how) for topic in self._kinds}
        self.write = WriteBlock(COMMAND[0], prefix=plan.prefix)
        self.arrivals = Arrivals(self._kinds)
        self._lock = threading.Lock()
        self._state: dict[str, Any] = {}
        self._sent = 0
        self._corner = 0

    def __call__(self) -> None:
        """Run one scan."""
        for topic, read in self.reads.items():
            for message in read.each():
                self.arrivals.add(topic, self._kinds[topic].open(message), time.time_ns())
        self._steer()
        blocks = {**self.reads, COMMAND[0]: self.write}
        waiting = {
            topic: block.reason or "the bridge sends no heartbeat"
            for topic, block in blocks.items()
            if block.udiError or not block.xPeerAlive
        }
        state = {
            "ready": not waiting and self.write.xReady,
            "waiting": waiting,
            "sent": {COMMAND[0]: self._sent},
            "received": {topic: asdict(tally) for topic, tally in self.arrivals.tallies.items()},
            "counters": {topic: {"lost": read.udiLost} for topic, read in self.reads.items()},
        }
        with self._lock:
            self._state = state

    def facts(self) -> dict[str, Any]:
        """Return what the last scan has left behind."""
        drained = self._commands.drain.is_set()
        with self._lock:
            return {"drained": drained, **self._state}

    def _steer(self) -> None:
        pose = self.reads["/turtle/pose"]
        write = self.write
        driving = self._commands.go.is_set() and not self._commands.drain.is_set()
        write.xEnable = driving and pose.xValid and not pose.xStale and write.msg is not None
        if write.xEnable and pose.msg is not None:
            p, q = pose.msg.pose.position, pose.msg.pose.orientation
            heading = 2 * math.atan2(q.z, q.w)
            forward, turn, self._corner = steer(p.x, p.y, heading, self._corner)
            write.msg.update(command(self._sent + 1, forward, turn))
        if write():
            self._sent += 1


def main() -> None:
    """Run the virtual PLC until told to stop."""
    commands = Commands()
    plan = Plan.from_json(sys.argv[1])
    program = PythonProgram(plan, commands)
    serve_demo(program, plan.interval, commands, program.arrivals, program.facts)
    for block in (*program.reads.values(), program.write):
        block.close()


if __name__ == "__main__":
    main()
