"""The cell in a terminal: drawn again on a screen, told line by line elsewhere."""

from __future__ import annotations

import shutil
import sys
import time
from typing import Any

from examples.assembly_cell.cell import Cell

__all__ = ["View"]

PHASES = ("free", "assembles", "places", "removes")
STAGES = {0: "looks", 10: "waits for the robot", 20: "presses", 30: "lifts"}
_FRAME_S = 0.1


class View:
    """Draws a cell whenever it is called with one.

    Args:
        live: Draw in place; otherwise tell what has changed.
    """

    def __init__(self, *, live: bool) -> None:
        self._live = live
        self._drawn = 0
        self._told: Any = None
        self._next = 0.0

    def __call__(self, cell: Cell, *, last: bool = False) -> None:
        """Show the cell as it is now; the last time, however soon after the one before."""
        if self._live:
            if last or time.monotonic() >= self._next:
                self._next = time.monotonic() + _FRAME_S
                self._draw(cell)
        else:
            self._tell(cell)

    def _draw(self, cell: Cell) -> None:
        # A line that the terminal wraps would count as two on the way back up.
        columns = shutil.get_terminal_size().columns
        lines = [line if len(line) < columns else line[: columns - 2] + "…" for line in picture(cell)]
        out = f"\x1b[{self._drawn}F" if self._drawn else ""
        sys.stdout.write(out + "".join(f"\x1b[2K{line}\n" for line in lines))
        sys.stdout.flush()
        self._drawn = len(lines)

    def _tell(self, cell: Cell) -> None:
        world = cell.world
        told = (world["phase"], world["stopped"], len(world["box"]), cell.program.get("stage"), cell.away)
        if told == self._told:
            return
        self._told = told
        stage = STAGES.get(cell.program.get("stage", -1), "is away")
        robot = "is stopped" if world["stopped"] else PHASES[world["phase"]]
        fault = f"  !! {cell.away} is away" if cell.away in ("bridge", "plc") else ""
        print(
            f"robot {robot:<10} press {stage:<20} nest {nest(world):<14} box {len(world['box'])}{fault}",
            flush=True,
        )


def nest(world: dict[str, Any]) -> str:
    """Return what lies in the nest."""
    handle = world["nest"]
    if handle is None:
        return "empty"
    return f"handle {handle['serial']}{' pinned' if handle['pins'] else ''}"


def picture(cell: Cell) -> list[str]:
    """Return the cell as lines of text."""
    world, program = cell.world, cell.program
    depth = round(world["cylinder"] * 2)
    rod = ["║" if row < depth else " " for row in range(2)]
    arm = "┳" if world["phase"] in (2, 3) else "─"
    hand = "" if world["gripper"] is None else f"#{world['gripper']}"
    robot = "STOPPED" if world["stopped"] else PHASES[world["phase"]]
    stage = STAGES.get(program.get("stage", -1), "away")
    bridge = "away" if cell.bridge_pid is None else "carries" if program.get("alive") else "starts"
    boxed = len(world["box"])
    full, done = "▯" * min(4, world["tray"]), "▮" * min(4, boxed)
    return [
        "     tray           robot               press             box",
        "   ┌──────┐      ┌─────────┐        ══════╦══════      ┌──────┐",
        f"   │ {full:<4} │ ───▶ │{robot:^9}│ ──{arm}──▶        {rod[0]}            │ {done:<4} │",
        f"   │ {world['tray']:>4} │      │{hand:^9}│              {rod[1]}            │ {boxed:>4} │",
        f"   └──────┘      └─────────┘     [{nest(world):^17}]    └──────┘",
        "",
        f"  robot {robot:<10} PLC ({cell.plc}) {stage:<20} bridge {bridge}",
        f"  faults: {', '.join(cell.broken) or 'none yet'}",
        f"  mishaps: {', '.join(world['mishaps']) or 'none'}",
    ]
