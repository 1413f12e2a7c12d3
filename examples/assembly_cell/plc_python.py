"""The press's program in the virtual PLC: PLC_PRG.st, line by line, in Python."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

from examples.assembly_cell.image import PlcSide
from examples.assembly_cell.world import PLACE, REMOVE
from rosplc.demo.plc import serve
from rosplc.demo.processes import Commands
from rosplc.virtual_plc import ActionClient, ReadBlock, WriteBlock

__all__ = ["Press", "Program", "run"]


class Press:
    """PROGRAM PLC_PRG: what is in ``st/PLC_PRG.st``, without the blocks around it.

    Attributes:
        uiStage: 0 looking, 10 waiting for the robot, 20 pressing, 30 rising.
        usiRobot: Phase of the hand-over, as the robot reported it last.
        udiPressed: Handles pressed since the start.
        udiHandedOver: Hand-overs since the start in which the robot moved.
        xPressDown: The output.
    """

    def __init__(self) -> None:
        self.uiStage = self.usiRobot = self.udiPressed = self.udiHandedOver = 0
        self.xPressDown = False
        self._heard = False

    def __call__(self, io: dict[str, bool], robot: Any, hand_over: Any, *, xNew: bool, xAlive: bool) -> None:
        """Run one scan.

        Args:
            io: The inputs.
            robot: The robot's latest message; None before the first.
            hand_over: The action's block, which was called before.
            xNew: The message is new.
            xAlive: The bridge lives and the message is not stale.
        """
        self._heard = self._heard or xNew
        ready = self._heard and xAlive and robot is not None and not robot.stopped and robot.phase == 0
        ready = ready and hand_over.xServer and not hand_over.xBusy
        self.xPressDown = False
        if self.uiStage == 0:
            if ready and io["xPressUp"]:
                self._look(io, robot, hand_over.goal)
        elif self.uiStage == 10:
            if hand_over.xNewFeedback:
                self.usiRobot = hand_over.feedback.phase
            if hand_over.xDone and hand_over.result.moved:
                self.udiHandedOver += 1
            if hand_over.xDone or hand_over.xError or hand_over.xAborted:
                self.usiRobot = self.uiStage = 0
        elif self.uiStage == 20:
            if io["xPinIn"]:
                self.udiPressed += 1
                self.uiStage = 30
            elif io["xZoneFree"]:
                self.xPressDown = True
            else:
                self.uiStage = 0
        elif io["xPressUp"]:
            self.uiStage = 0
        hand_over.xExecute = self.uiStage == 10

    def _look(self, io: dict[str, bool], robot: Any, goal: Any) -> None:
        """Choose what is next from what is there."""
        if not io["xOccupied"]:
            if robot.tray > 0:
                goal.what, goal.serial, self.uiStage = PLACE, robot.placed + 1, 10
        elif io["xPinIn"]:
            goal.what, goal.serial, self.uiStage = REMOVE, robot.placed, 10
        elif io["xZoneFree"]:
            self.uiStage = 20


class Program:
    """The task's program: blocks, wires, and the press."""

    def __init__(self, folder: Path, prefix: str) -> None:
        self._wires = PlcSide(folder / "wires")
        self._robot = ReadBlock("/robot/state", prefix=prefix, stale_after=0.5)
        self._hand_over = ActionClient("/robot/hand_over", prefix=prefix)
        self._state = WriteBlock("/press/state", prefix=prefix)
        self._press = Press()

    def __call__(self) -> None:
        """Run one scan."""
        robot, press, io = self._robot, self._press, self._wires.inputs()
        robot()
        self._hand_over()
        press(
            io,
            robot.msg if robot.xValid else None,
            self._hand_over,
            xNew=robot.xNew,
            xAlive=robot.xPeerAlive and not robot.xStale,
        )
        self._wires.output(press.xPressDown)
        if self._state.msg is not None:
            self._state.msg.update(
                {
                    "stage": press.uiStage,
                    "occupied": io["xOccupied"],
                    "pin_in": io["xPinIn"],
                    "zone_free": io["xZoneFree"],
                    "robot": press.usiRobot,
                    "pressed": press.udiPressed,
                    "handed_over": press.udiHandedOver,
                }
            )
        self._state.xEnable = self._state.msg is not None
        self._state()

    def facts(self) -> dict[str, Any]:
        """Return what the cell shows of the program."""
        return {
            "stage": self._press.uiStage,
            "busy": self._hand_over.xBusy,
            "pressed": self._press.udiPressed,
            "handed_over": self._press.udiHandedOver,
            "alive": self._robot.xPeerAlive,
            "stale": self._robot.xStale,
        }

    def close(self) -> None:
        """Let go of the channels."""
        for block in (self._robot, self._hand_over, self._state):
            block.close()


def run(program: Any) -> None:
    """Run either program in the PLC's task, every ten milliseconds, until told to stop."""
    serve(program, 0.01, Commands(), lambda stats: {"scans": stats.scans, **program.facts()})
    program.close()


if __name__ == "__main__":
    run(Program(Path(sys.argv[1]), sys.argv[2]))
