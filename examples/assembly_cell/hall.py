"""The hall's process: the robot with its ROS 2 node, and the machine's mechanics.

It takes the robot's jobs from ROS and tells its state there, moves what is to be moved, and reads and sets
the machine's wires. Started by ``python -m examples.assembly_cell``.
"""

from __future__ import annotations

import sys
import threading
import time
from pathlib import Path
from typing import Any

from examples.assembly_cell.image import Machine
from examples.assembly_cell.world import World
from rosplc.codec import Codec, Wire
from rosplc.demo.processes import Commands, report
from rosplc.errors import RosplcError
from rosplc.layout import compute_layout
from rosplc.model import TypeStore
from rosplc.ros import Qos, open_backend

MSG = Path(__file__).parent / "msg"
STATE, JOB = "assembly_msgs/msg/RobotState", "assembly_msgs/msg/Job"
_STEP_S, _SAY_S, _REPORT_S = 0.005, 0.05, 0.05
_LONGEST_S = 0.02  # a step is never longer: on a loaded machine things move slowly, not in leaps


class Robot:
    """The robot's node: jobs in, state out."""

    def __init__(self, world: World, lock: threading.Lock, domain: int) -> None:
        store = TypeStore.bundled("jazzy").with_paths([MSG])
        self._world, self._lock = world, lock
        self._job = Codec(compute_layout(store, JOB), Wire.CDR)
        self._state = Codec(compute_layout(store, STATE), Wire.CDR)
        self._node = open_backend("dds", store, "assembly_robot", domain=domain)
        self._publisher = self._node.advertise("/robot/state", STATE, Qos(depth=1))
        self._node.subscribe("/robot/job", JOB, Qos(depth=1), self._on_job)

    def _on_job(self, payload: bytes, stamp_ns: int) -> None:
        job = self._job.layout.to_dict(self._job.decode(payload))
        with self._lock:
            self._world.wish(job["number"], job["what"], job["serial"])

    def say(self) -> None:
        """Publish the robot's state."""
        with self._lock:
            state = {
                "phase": self._world.phase,
                "stopped": self._world.stopped,
                "done": self._world.reply.udiDone,
                "placed": self._world.placed,
                "delivered": len(self._world.box),
                "tray": self._world.tray,
            }
        self._publisher.write(self._state.encode(self._state.layout.pack(state)))

    def close(self) -> None:
        """Leave the graph."""
        self._node.close()


def facts(world: World) -> dict[str, Any]:
    """Return what the cell shows of the world."""
    return {
        "phase": world.phase,
        "stopped": world.stopped,
        "tray": world.tray,
        "placed": world.placed,
        "nest": None if world.nest is None else {"serial": world.nest.serial, "pins": world.nest.pins},
        "gripper": None if world.gripper is None else world.gripper.serial,
        "cylinder": world.cylinder,
        "box": list(world.box),
        "mishaps": list(world.mishaps),
    }


def main() -> None:
    """Run the hall until told to stop: its arguments are domain, file of the wires, number of handles."""
    commands = Commands("estop", "reset")
    world, lock = World(tray=int(sys.argv[3])), threading.Lock()
    machine = Machine(Path(sys.argv[2]))
    try:
        robot = Robot(world, lock, int(sys.argv[1]))
    except RosplcError as error:
        report("error", **error.to_dict())
        sys.exit(1)
    last, said, told = time.monotonic(), 0.0, 0.0
    while not commands.stop.wait(_STEP_S):
        now = time.monotonic()
        with lock:
            for word, stopped in (("estop", True), ("reset", False)):
                if commands.others[word].is_set():
                    commands.others[word].clear()
                    world.stopped = stopped
            world.step(min(now - last, _LONGEST_S), press_down=machine.press_down)
            nest = world.nest
            machine.set(
                nest is not None, nest is not None and nest.pins > 0, world.zone_free, world.cylinder == 0.0
            )
        last = now
        if now - said >= _SAY_S:
            said = now
            robot.say()
        if now - told >= _REPORT_S:
            told = now
            report("status", **facts(world))
    report("status", **facts(world))
    robot.close()


if __name__ == "__main__":
    main()
