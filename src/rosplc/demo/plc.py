"""The virtual PLC's process: takes the robot's messages, steers it, knows nothing of ROS.

The task, and what is kept of messages, it shares with the process that runs Structured Text.
"""

from __future__ import annotations

import math
import sys
import threading
import time
from abc import ABC, abstractmethod
from collections import deque
from collections.abc import Callable, Iterable, Mapping
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


class Program(ABC):
    """A PLC program of the demonstration; ``state`` is what it last knew, guarded by ``lock``.

    Outputs of blocks are attributes, and so is ``reason``, why a block waits.
    """

    def __init__(self, reads: Mapping[str, Any], write: Any) -> None:
        self.reads = reads  # the blocks by topic
        self.write = write  # the command's
        self.arrivals = Arrivals(reads)
        self.lock = threading.Lock()
        self.state: dict[str, Any] = {}

    @abstractmethod
    def __call__(self) -> None:
        """Run one scan."""

    def note(self, sent: int, **more: Any) -> None:
        """Keep what a scan has left behind; so many commands have been sent."""
        blocks = {**self.reads, COMMAND[0]: self.write}
        waiting = {
            topic: block.reason or "the bridge does not beat"
            for topic, block in blocks.items()
            if block.udiError or not block.xPeerAlive
        }
        counters = {"sequence": "udiSequence", "lost": "udiLost", "error": "udiError"}
        state = {
            "ready": not waiting and bool(self.write.xReady),
            "waiting": waiting,
            "sent": {COMMAND[0]: sent},
            "received": {topic: asdict(tally) for topic, tally in self.arrivals.tallies.items()},
            "counters": {
                topic: {key: getattr(read, output) for key, output in counters.items()}
                for topic, read in self.reads.items()
            },
        }
        with self.lock:
            self.state = state | more


def serve_demo(program: Program, interval: float, commands: Commands) -> None:
    """Run a program of the demonstration; its last report has the ages of all messages."""

    def facts(stats: CycleStats) -> dict[str, Any]:
        with program.lock:
            state = program.state
        age, drained = program.arrivals.recent(), commands.drain.is_set()
        return {"drained": drained, "cycle": stats.to_dict(), "age": age, **state}

    stats = serve(program, interval, commands, facts)
    report("status", cycle=stats.to_dict(), ages=program.arrivals.summary(), **program.state)


class PythonProgram(Program):
    """The PLC program: reads every topic, computes the command from the pose."""

    def __init__(self, plan: Plan, commands: Commands) -> None:
        self._commands = commands
        self._kinds = robot_topics(plan.topics)
        how: dict[str, Any] = {"mode": "every", "max_per_cycle": plan.per_scan, "stale_after": 0.5}
        reads = {topic: ReadBlock(topic, prefix=plan.prefix, **how) for topic in self._kinds}
        super().__init__(reads, WriteBlock(COMMAND[0], prefix=plan.prefix))
        self._sent = 0
        self._corner = 0

    def __call__(self) -> None:
        """Run one scan."""
        for topic, read in self.reads.items():
            for message in read.each():
                self.arrivals.add(topic, self._kinds[topic].open(message), time.time_ns())
        self._steer()
        self.note(self._sent)

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
    serve_demo(program, plan.interval, commands)
    for block in (*program.reads.values(), program.write):
        block.close()


if __name__ == "__main__":
    main()
