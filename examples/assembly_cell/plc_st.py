"""The press's program in Structured Text: the generated project and ``st/PLC_PRG.st``, translated and run.

No CODESYS is involved; the translator belongs to the checkout (tests/st/rosplc_st).
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

from examples.assembly_cell.image import PlcSide
from examples.assembly_cell.plc_python import run
from rosplc.demo.st.process import find_translator
from rosplc_st.run_project import load_texts

__all__ = ["PROGRAMS", "Program"]

_SHOW_EVERY = 5  # scans
PROGRAMS = ("SharedMemory_Read", "PLC_PRG", "SharedMemory_Write")


class Program:
    """The project as a program of the task; the host maps the wires, as a fieldbus does."""

    def __init__(self, folder: Path) -> None:
        translator = find_translator()
        self._wires = PlcSide(folder / "wires")
        self._machine = translator.machine(translator.build(load_texts(folder / "plc")))
        self._machine.start()
        self._scans = 0
        self._facts: dict[str, Any] = {}

    def __call__(self) -> None:
        """Run one scan."""
        for name, value in self._wires.inputs().items():
            self._machine.set(f"IO.{name}", value)
        for program in PROGRAMS:
            self._machine.scan(program, step=0)
        self._wires.output(bool(self._machine.get("IO.xPressDown")))
        if self._scans % _SHOW_EVERY == 0:
            self._facts = self._look()  # by this thread: the machine serves one at a time
        self._scans += 1

    def facts(self) -> dict[str, Any]:
        """Return what the cell shows of the program."""
        return self._facts

    def _look(self) -> dict[str, Any]:
        get = self._machine.get
        return {
            "stage": get("PLC_PRG.uiStage"),
            "busy": bool(get("ROS_Actions.robot_hand_over.xBusy")),
            "pressed": get("PLC_PRG.udiPressed"),
            "handed_over": get("PLC_PRG.udiHandedOver"),
            "alive": bool(get("ROS_Read.robot_state.xPeerAlive")),
            "stale": bool(get("ROS_Read.robot_state.xStale")),
        }

    def close(self) -> None:
        """Stop as a PLC does; what it claimed is given back."""
        self._machine.stop()


if __name__ == "__main__":
    run(Program(Path(sys.argv[1])))
