"""The task of the PLC's process, whichever program it runs: every ten milliseconds, until told to stop."""

from __future__ import annotations

from typing import Any, Protocol

from rosplc.demo.processes import Commands, report
from rosplc.virtual_plc import VirtualPlc

__all__ = ["serve"]

INTERVAL_S = 0.01
_REPORT_S = 0.05


class Program(Protocol):
    """What the task calls."""

    def __call__(self) -> None:
        """Run one scan."""

    def facts(self) -> dict[str, Any]:
        """Return what the cell shows of the program."""

    def close(self) -> None:
        """End it."""


def serve(program: Program) -> None:
    """Run the program, and report what it does."""
    commands = Commands()
    plc = VirtualPlc()
    task = plc.task("RosTask", INTERVAL_S, priority=4)
    task.program(program)
    with plc:
        while not commands.stop.wait(_REPORT_S):
            plc.check()
            report("status", scans=task.stats.scans, **program.facts())
    program.close()
