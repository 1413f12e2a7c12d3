"""The hall's process: the robot with its ROS 2 node, and the machine's mechanics.

It serves the hand-over's action in ROS and publishes the robot's state there, moves what is to be moved, and
reads and sets the machine's wires. Started by ``python -m examples.assembly_cell``.
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
from rosplc.ros import ActionServer, Qos, open_backend

MSG = Path(__file__).parent / "msg"
STATE, HAND_OVER = "assembly_msgs/msg/RobotState", "assembly_msgs/action/HandOver"
_STEP_S, _SAY_S, _REPORT_S = 0.005, 0.05, 0.05
_LONGEST_S = 0.02  # a step is never longer: on a loaded machine things move slowly, not in leaps


class Robot:
    """The robot's node: it serves the action ``/robot/hand_over``, and publishes its state."""

    def __init__(self, world: World, lock: threading.RLock, domain: int) -> None:
        store = TypeStore.bundled("jazzy").with_paths([MSG])
        self._world, self._lock = world, lock
        types = (STATE, *(f"{HAND_OVER}_{part}" for part in ("Goal", "Feedback", "Result")))
        self._codecs = [Codec(compute_layout(store, name), Wire.CDR) for name in types]
        self._goal = b""
        self._ended = world.ended
        self._node = open_backend("dds", store, "assembly_robot", domain=domain)
        self._publisher = self._node.advertise("/robot/state", STATE, Qos(depth=1))
        with lock:  # a goal may come at once
            self._server = ActionServer(
                self._node,
                store,
                "/robot/hand_over",
                HAND_OVER,
                on_goal=self._on_goal,
                on_cancel=self._on_cancel,
            )

    def _on_goal(self, uuid: bytes, payload: bytes) -> None:
        """Accept what the robot can do now, and reject the rest; the PLC looks again then."""
        codec = self._codecs[1]
        goal = codec.layout.view(codec.decode(payload))
        with self._lock:
            if not self._world.take(goal.what, goal.serial):
                self._server.reject(uuid)
                return
            self._goal = uuid
            self._server.accept(uuid)
            self._server.execute(uuid)

    def _on_cancel(self, uuid: bytes) -> None:
        """Give a job back, unless the arm is in the machine: it finishes its way there."""
        with self._lock:
            if uuid == self._goal and self._world.drop():
                self._server.accept_cancel(uuid)
                self._server.canceled(uuid)
            else:
                self._server.reject_cancel(uuid)

    def report(self) -> None:
        """Tell the PLC when its job is done."""
        if self._world.ended != self._ended:
            self._ended = self._world.ended
            self._server.succeed(self._goal, self._encode(3, moved=self._world.moved))

    def say(self) -> None:
        """Publish the robot's state, and how far its job is."""
        world = self._world
        self._publisher.write(
            self._encode(
                0,
                phase=world.phase,
                stopped=world.stopped,
                placed=world.placed,
                delivered=len(world.box),
                tray=world.tray,
            )
        )
        self._server.feedback(self._goal, self._encode(2, phase=world.phase, way=world.way))
        self._server.tick()

    def _encode(self, number: int, **fields: Any) -> bytes:
        codec = self._codecs[number]
        return codec.encode(codec.layout.pack(fields))

    def close(self) -> None:
        """Leave the graph."""
        self._server.close()
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
    world, lock = World(tray=int(sys.argv[3])), threading.RLock()
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
            robot.report()
            if now - said >= _SAY_S:
                said = now
                robot.say()
        last = now
        if now - told >= _REPORT_S:
            told = now
            report("status", **facts(world))
    report("status", **facts(world))
    robot.close()


if __name__ == "__main__":
    main()
