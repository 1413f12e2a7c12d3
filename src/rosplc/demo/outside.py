"""A PLC program in Structured Text, seen from the outside: what it took, and what its channels say.

The program passes on every message that it took, with the time at which it had it in hand, over channels of
the process that watches it. Each is counted and checked there with the very code that counts for Python.
"""

from __future__ import annotations

import json
from contextlib import ExitStack
from dataclasses import asdict
from pathlib import Path
from typing import Any

from rosplc.config.resolve import Project, load_project
from rosplc.demo.plan import COMMAND, Plan, robot_topics
from rosplc.demo.plc import Arrivals
from rosplc.demo.processes import Commands
from rosplc.described import description_of
from rosplc.monitor.watch import Watch
from rosplc.shm import Namespace, OwnedChannel

DRIVE, TAKEN = "/demo/drive", "/demo/taken"  # the operator's switch; before the names of topics
STEER = Path(__file__).parent / "st" / "Demo_Steer.st"  # the control law, for every kind of PLC
_CONFIGURATION = "rosplc.yaml"


def write_configuration(folder: Path, plan: Plan) -> Project:
    """Write the configuration of the PLC's half, and return it: the bridge's, and the topics of its own."""
    configuration = plan.configuration()
    topics = configuration["topics"]
    topics |= {f"{TAKEN}{topic}": {**topics[topic], "to": "ros"} for topic in robot_topics(plan.topics)}
    topics[DRIVE] = {"type": "std_msgs/msg/Bool", "to": "plc", "stale_after": "500ms"}
    (folder / _CONFIGURATION).write_text(json.dumps(configuration, indent=2), encoding="utf-8")
    return load_project(folder / _CONFIGURATION)


class Outside:
    """The watcher of a folder's program; its channels are closed with ``stack``."""

    def __init__(self, plan: Plan, commands: Commands, folder: Path, stack: ExitStack) -> None:
        self._commands = commands
        self._kinds = robot_topics(plan.topics)
        self.arrivals = Arrivals(self._kinds)
        self._plans = {one.topic: one for one in load_project(folder / _CONFIGURATION).topics}
        channels = {}
        for topic, own in self._plans.items():
            if topic.startswith("/demo/"):
                about = description_of(own.layout, topic, own.direction, bridge="demo")
                size = own.layout.size
                opened = OwnedChannel.open(Namespace(plan.prefix), about, record_size=size, slots=plan.slots)
                stack.callback(opened.close)
                channels[topic] = opened
        self._drive = channels[DRIVE].writer()
        self._readers = {topic: channels[f"{TAKEN}{topic}"].reader() for topic in self._kinds}
        self._halted = 0  # the first message that told the program to drive no more
        self._watch = stack.enter_context(Watch(plan.prefix))

    def status(self) -> dict[str, Any]:
        """Set the operator's switch; return what the parent shows and compares. To be called every 0.1 s."""
        halt = self._commands.drain.is_set()
        driving = self._commands.go.is_set() and not halt
        number = self._drive.publish(self._plans[DRIVE].layout.pack({"data": driving}))
        self._halted = self._halted or number * halt
        for topic, reader in self._readers.items():
            layout, open_message = self._plans[topic].layout, self._kinds[topic].open
            record = bytearray(layout.size)
            while taken := reader.next(record):
                self.arrivals.add(topic, open_message(layout.view(record)), taken.stamp_ns)
            reader.beat()
        views = {view.topic: view for view in self._watch.look().channels}
        alive = {topic for topic, view in views.items() if view.plc_alive and view.bridge_alive}
        waiting = {
            topic: views[topic].words if topic in views else "no object yet"
            for topic in self._plans.keys() - alive
        }
        # The switch was taken before the commands were counted.
        drained = 0 < self._halted <= max((line.taken for line in views[DRIVE].readers), default=0)
        command = views.get(COMMAND[0])
        return {
            "ready": not waiting,
            "waiting": waiting,
            "drained": drained,
            "sent": {COMMAND[0]: command.received if command else 0},
            "received": {topic: asdict(tally) for topic, tally in self.arrivals.tallies.items()},
            "counters": {topic: {"lost": views[topic].lost} for topic in self._kinds if topic in views},
        }
