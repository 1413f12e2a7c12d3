"""The machine's wiring: inputs and outputs as single bytes in a file that both sides map.

It stands for a fieldbus. Its master counts; where the count is still for a tenth of a second the outputs
fall off, as they do on a real one when the PLC stops.
"""

from __future__ import annotations

import mmap
import time
from pathlib import Path

__all__ = ["INPUTS", "Machine", "PlcSide"]

INPUTS = ("xOccupied", "xPinIn", "xZoneFree", "xPressUp")
_PRESS_DOWN, _LIFE, _SIZE = 8, 9, 16
_DEAD_S = 0.1


class _Image:
    def __init__(self, path: Path) -> None:
        with path.open("r+b") as file:
            self._bytes = mmap.mmap(file.fileno(), _SIZE)


class Machine(_Image):
    """The machine's end of the wires; makes the file."""

    def __init__(self, path: Path) -> None:
        path.write_bytes(bytes(_SIZE))
        super().__init__(path)
        self._life, self._since = 0, 0.0

    def set(self, *inputs: bool) -> None:
        """Set all inputs, in the order of :data:`INPUTS`."""
        self._bytes[: len(inputs)] = bytes(inputs)

    @property
    def press_down(self) -> bool:
        """The output; False where no PLC lives."""
        now, life = time.monotonic(), self._bytes[_LIFE]
        if life != self._life:
            self._life, self._since = life, now
        return bool(self._bytes[_PRESS_DOWN]) and now - self._since < _DEAD_S


class PlcSide(_Image):
    """The PLC's end of the wires."""

    def inputs(self) -> dict[str, bool]:
        """Return the inputs by name."""
        return {name: bool(self._bytes[number]) for number, name in enumerate(INPUTS)}

    def output(self, press_down: bool) -> None:
        """Set the output, and show that the PLC lives."""
        self._bytes[_PRESS_DOWN] = press_down
        self._bytes[_LIFE] = (self._bytes[_LIFE] + 1) % 256
