"""The virtual PLC's process: takes the robot's messages, steers it, knows nothing of ROS."""

from __future__ import annotations

import math
import sys
import threading
import time
from typing import Any

from rosplc.demo.messages import COMMAND, command, robot_topics, steer
from rosplc.demo.plan import Plan
from rosplc.demo.processes import Commands
from rosplc.demo.task import Arrivals, serve_demo
from rosplc.virtual_plc import ReadBlock, WriteBlock


class Program:
    """The PLC program: reads every topic, computes the command from the pose."""

    def __init__(self, plan: Plan, commands: Commands) -> None:
        self._commands = commands
        self._kinds = robot_topics(plan.topics)
        self.reads = {
            topic: ReadBlock(
                topic, prefix=plan.prefix, mode="every", max_per_cycle=plan.per_scan, stale_after=0.5
            )
            for topic in self._kinds
        }
        self.write = WriteBlock(COMMAND[0], prefix=plan.prefix)
        self.blocks: list[ReadBlock | WriteBlock] = [*self.reads.values(), self.write]
        self.arrivals = Arrivals(self._kinds)
        self.sent = 0
        self.lock = threading.Lock()
        self.state: dict[str, Any] = {}
        self._corner = 0

    def __call__(self) -> None:
        """Run one scan."""
        for topic, read in self.reads.items():
            kind = self._kinds[topic]
            for message in read.each():
                opened = kind.open(message)
                self.arrivals.add(topic, opened, time.time_ns())
        self._steer()
        with self.lock:
            self.state = self._state()

    def _steer(self) -> None:
        pose = self.reads["/turtle/pose"]
        write = self.write
        driving = self._commands.go.is_set() and not self._commands.drain.is_set()
        write.xEnable = driving and pose.xValid and not pose.xStale and write.msg is not None
        if write.xEnable and pose.msg is not None:
            p, q = pose.msg.pose.position, pose.msg.pose.orientation
            heading = 2 * math.atan2(q.z, q.w)
            forward, turn, self._corner = steer(p.x, p.y, heading, self._corner)
            write.msg.update(command(self.sent + 1, forward, turn))
        if write():
            self.sent += 1

    def _state(self) -> dict[str, Any]:
        reads, write = self.reads, self.write
        counters = {"sequence": "udiSequence", "lost": "udiLost", "error": "udiError"}
        return {
            "ready": all(block.xPeerAlive for block in self.blocks) and write.xReady,
            "waiting": {
                block.topic: block.reason or "the bridge does not beat"
                for block in self.blocks
                if block.udiError or not block.xPeerAlive
            },
            "sent": {COMMAND[0]: self.sent},
            "received": {topic: tally.to_dict() for topic, tally in self.arrivals.tallies.items()},
            "counters": {
                topic: {key: getattr(read, output) for key, output in counters.items()}
                for topic, read in reads.items()
            },
        }


def main() -> None:
    """Run the virtual PLC until told to stop."""
    commands = Commands()
    plan = Plan.from_json(sys.argv[1])
    program = Program(plan, commands)
    serve_demo(program, plan.interval, commands)
    for block in program.blocks:
        block.close()


if __name__ == "__main__":
    main()
