"""The virtual PLC's process: takes the robot's messages, steers it, knows nothing of ROS."""

from __future__ import annotations

import math
import sys
import threading
import time
from collections import deque
from statistics import median, quantiles
from typing import Any

from rosplc.demo.messages import COMMAND, command, robot_topics
from rosplc.demo.pipe import Orders, report
from rosplc.demo.plan import Plan
from rosplc.demo.tally import Tally
from rosplc.demo.turtle import steer
from rosplc.virtual_plc import ReadBlock, VirtualPlc, WriteBlock

__all__ = ["main"]

_STATUS_SECONDS = 0.1
_AGES_KEPT = 200_000


class Program:
    """The PLC program: reads every topic, computes the command from the pose."""

    def __init__(self, plan: Plan, orders: Orders) -> None:
        self._orders = orders
        self._kinds = robot_topics(plan.topics)
        self.reads = {
            topic: ReadBlock(
                topic, prefix=plan.prefix, mode="every", max_per_cycle=plan.per_scan, stale_after=0.5
            )
            for topic in self._kinds
        }
        self.write = WriteBlock(COMMAND[0], prefix=plan.prefix)
        self.blocks: list[ReadBlock | WriteBlock] = [*self.reads.values(), self.write]
        self.tallies = {topic: Tally() for topic in self._kinds}
        self.sent = 0
        self.lock = threading.Lock()
        self.ages: dict[str, deque[int]] = {topic: deque(maxlen=_AGES_KEPT) for topic in self._kinds}
        self.state: dict[str, Any] = {}
        self._corner = 0

    def __call__(self) -> None:
        """Run one scan."""
        for topic, read in self.reads.items():
            kind, tally = self._kinds[topic], self.tallies[topic]
            for message in read.each():
                opened = kind.open(message)
                tally.add(opened.number, whole=opened.whole)
                if opened.whole:
                    self.ages[topic].append(time.time_ns() - opened.stamp_ns)
        self._steer()
        with self.lock:
            self.state = self._state()

    def _steer(self) -> None:
        pose = self.reads["/turtle/pose"]
        write = self.write
        driving = self._orders.go.is_set() and not self._orders.drain.is_set()
        write.xEnable = driving and pose.xValid and not pose.xStale and write.msg is not None
        if write.xEnable and pose.msg is not None:
            p, q = pose.msg.pose.position, pose.msg.pose.orientation
            heading = 2 * math.atan2(q.z, q.w)
            forward, turn, self._corner = steer(p.x, p.y, heading, self._corner)
            write.msg.update(command(self.sent + 1, forward, turn))
        if write():
            self.sent += 1

    def _state(self) -> dict[str, Any]:
        return {
            "ready": all(read.xPeerAlive for read in self.reads.values())
            and self.write.xReady
            and self.write.xPeerAlive,
            "waiting": {
                block.topic: block.reason or "the bridge does not beat"
                for block in self.blocks
                if block.udiError or not block.xPeerAlive
            },
            "sent": {COMMAND[0]: self.sent},
            "received": {topic: tally.to_dict() for topic, tally in self.tallies.items()},
            "counters": {topic: _counters(read) for topic, read in self.reads.items()},
        }

    def age_summary(self) -> dict[str, dict[str, float]]:
        """Return median and p99 age in milliseconds, per topic and over all (``""``)."""
        ages = {topic: list(values) for topic, values in self.ages.items()}
        ages[""] = [age for values in list(ages.values()) for age in values]
        return {topic: _percentiles(values) for topic, values in ages.items() if values}

    def recent_ages(self) -> dict[str, float]:
        """Return the age in milliseconds of each topic's last message."""
        return {topic: values[-1] / 1e6 for topic, values in self.ages.items() if values}


def _counters(read: ReadBlock) -> dict[str, int]:
    return {"sequence": read.udiSequence, "lost": read.udiLost, "error": read.udiError}


def _percentiles(values: list[int]) -> dict[str, float]:
    p99 = quantiles(values, n=100, method="inclusive")[98] if len(values) > 1 else values[0]
    return {"median_ms": median(values) / 1e6, "p99_ms": p99 / 1e6}


def main() -> None:
    """Run the virtual PLC until told to stop."""
    orders = Orders()
    plan = Plan.from_json(sys.argv[1])
    program = Program(plan, orders)
    plc = VirtualPlc()
    task = plc.task("RosTask", plan.interval, priority=4)
    task.program(program)
    with plc:
        while not orders.stop.wait(_STATUS_SECONDS):
            plc.check()
            with program.lock:
                state = program.state
            report(
                "status",
                drained=orders.drain.is_set(),
                cycle=task.stats.to_dict(),
                age=program.recent_ages(),
                **state,
            )
    report("status", cycle=task.stats.to_dict(), ages=program.age_summary(), **program.state)
    for block in program.blocks:
        block.close()


if __name__ == "__main__":
    main()
