"""What a container is made of: processes in namespaces of their own, without an engine."""

from __future__ import annotations

import os
import signal
import time
from collections.abc import Sequence
from pathlib import Path

from tests.soak.processes import Part

__all__ = ["Contained", "Enclosed", "contain"]

WATCHDOG_S = 120.0
_NAMESPACES = ("--mount", "--pid", "--ipc", "--uts")


def contain(command: Sequence[str], *, shm: Path | None, network: bool) -> list[str]:
    """Return the command line that runs a program as process 1 of a container.

    Args:
        command: The program and its arguments.
        shm: What it sees at ``/dev/shm``; None for a tmpfs of its own, which an engine gives by default.
        network: Whether it has the machine's network, or none.
    """
    mount = "mount -t tmpfs -o mode=1777 shm /dev/shm" if shm is None else f"mount --bind '{shm}' /dev/shm"
    kinds = (*_NAMESPACES, *(() if network else ("--net",)))
    script = f'set -e; {mount}; exec "$@"'
    return ["unshare", *kinds, "--kill-child", "--mount-proc", "sh", "-c", script, "sh", *command]


class Enclosed(Part):
    """A part that ``unshare`` starts, as process 1 of namespaces of its own."""

    @property
    def inner(self) -> int:
        """The number that the machine knows the container's process 1 by."""
        deadline = time.monotonic() + WATCHDOG_S
        while not (children := Path(f"/proc/{self.pid}/task/{self.pid}/children").read_text().split()):
            assert time.monotonic() < deadline and self.alive, self.log.read_text()
            time.sleep(0.01)
        return int(children[0])

    def send(self, number: signal.Signals) -> None:
        """Send a signal to the program, as an engine does; kill -9 takes the container with it."""
        if self.alive and number != signal.SIGKILL:
            os.kill(self.inner, number)
        else:
            super().send(number)


class Contained(Enclosed):
    """A part of a cell, in a container.

    Args:
        part: The part, as the cell has it.
        shm: As :func:`contain` has it.
        network: As :func:`contain` has it.
    """

    def __init__(self, part: Part, *, shm: Path | None, network: bool) -> None:
        def command() -> list[str]:
            return contain(part._command(), shm=shm, network=network)

        super().__init__(part.name, command, part.environment, part.log)
