"""The press's program in the virtual PLC: PLC_PRG.st, line by line, in Python."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

from examples.assembly_cell.handshake import Handshake
from examples.assembly_cell.image import PlcSide
from rosplc.demo.processes import Commands
from rosplc.demo.task import serve
from rosplc.virtual_plc import ReadBlock, WriteBlock

__all__ = ["Press", "Program", "run"]


class Press:
    """PROGRAM PLC_PRG: what stands in ``st/PLC_PRG.st``, without the blocks around it.

    Attributes:
        uiStage: 0 looking, 10 waiting for the robot, 20 pressing, 30 rising.
        usiWhat: The job: 1 place, 2 remove.
        udiSerial: Its handle.
        udiPressed: Handles pressed since the start.
        xPressDown: The output.
    """

    def __init__(self) -> None:
        self.uiStage = self.usiWhat = self.udiSerial = self.udiPressed = 0
        self.xPressDown = False
        self.fbRobot = Handshake()
        self._execute = False
        self._heard = False

    def __call__(self, io: dict[str, bool], robot: Any, *, xNew: bool, xAlive: bool) -> None:
        """Run one scan.

        Args:
            io: The inputs.
            robot: The robot's latest message; None before the first.
            xNew: It is new.
            xAlive: The bridge lives and the message is not stale.
        """
        self._heard = self._heard or xNew
        alive = self._heard and xAlive and robot is not None
        ready = alive and not robot.stopped and robot.phase == 0
        self.xPressDown = False
        if self.uiStage == 0:
            self._execute = False
            if ready and io["xPressUp"] and not self.fbRobot.xBusy:
                self._look(io, robot)
        elif self.uiStage == 10:
            self._execute = True
            if self.fbRobot.xDone or self.fbRobot.xError:
                self._execute = False
                self.uiStage = 0
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
        self.fbRobot(xExecute=self._execute, udiDone=robot.done if robot is not None else 0, xPeerAlive=alive)

    def _look(self, io: dict[str, bool], robot: Any) -> None:
        """Choose what is next from what is there."""
        if not io["xOccupied"]:
            if robot.tray > 0:
                self.usiWhat, self.udiSerial, self.uiStage = 1, robot.placed + 1, 10
        elif io["xPinIn"]:
            self.usiWhat, self.udiSerial, self.uiStage = 2, robot.placed, 10
        elif io["xZoneFree"]:
            self.uiStage = 20


class Program:
    """The task's program: blocks, wires, and the press."""

    def __init__(self, folder: Path, prefix: str) -> None:
        self._wires = PlcSide(folder / "wires")
        self._robot = ReadBlock("/robot/state", prefix=prefix, stale_after=0.5)
        self._job = WriteBlock("/robot/job", prefix=prefix)
        self._state = WriteBlock("/press/state", prefix=prefix)
        self._press = Press()

    def __call__(self) -> None:
        """Run one scan."""
        robot, press, io = self._robot, self._press, self._wires.inputs()
        robot()
        press(
            io,
            robot.msg if robot.xValid else None,
            xNew=robot.xNew,
            xAlive=robot.xPeerAlive and not robot.xStale,
        )
        self._wires.output(press.xPressDown)
        if self._job.msg is not None:
            self._job.msg.update(
                {"number": press.fbRobot.udiJob, "what": press.usiWhat, "serial": press.udiSerial}
            )
        if self._state.msg is not None:
            self._state.msg.update(
                {
                    "stage": press.uiStage,
                    "occupied": io["xOccupied"],
                    "pin_in": io["xPinIn"],
                    "zone_free": io["xZoneFree"],
                    "pressed": press.udiPressed,
                }
            )
        for block in (self._job, self._state):
            block.xEnable = block.msg is not None
            block()

    def facts(self) -> dict[str, Any]:
        """Return what the cell shows of the program."""
        return {
            "stage": self._press.uiStage,
            "job": self._press.fbRobot.udiJob,
            "pressed": self._press.udiPressed,
            "alive": self._robot.xPeerAlive,
            "stale": self._robot.xStale,
        }

    def close(self) -> None:
        """Let go of the channels."""
        for block in (self._robot, self._job, self._state):
            block.close()


def run(program: Any) -> None:
    """Run either program in the PLC's task, every ten milliseconds, until told to stop."""
    serve(program, 0.01, Commands(), lambda stats: {"scans": stats.scans, **program.facts()})
    program.close()


if __name__ == "__main__":
    run(Program(Path(sys.argv[1]), sys.argv[2]))
