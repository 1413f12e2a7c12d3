"""One side of an exchange: a process that takes orders line by line and answers likewise."""

from __future__ import annotations

import contextlib
import ctypes
import json
import os
import selectors
import signal
import subprocess
import tempfile
import time
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

from rosplc.errors import SetupError

__all__ = ["Side", "pin"]

_LAST_LINES = 12


class Side:
    """A running process.

    Args:
        name: What people call it.
        command: Its command line.

    Attributes:
        pid: Its process id.
    """

    def __init__(self, name: str, command: Sequence[str]) -> None:
        self._name = name
        self._log = tempfile.TemporaryFile("w+", errors="replace")  # noqa: SIM115 - closed in close()
        # Its own session: Ctrl-C reaches this process alone, which then ends the others.
        self._process = subprocess.Popen(
            [*command],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=self._log,
            start_new_session=True,
        )
        self.pid = self._process.pid
        self._buffer = b""
        try:
            self._clock = _cpu_clock(self.pid)
        except BaseException:  # nobody else knows of it yet
            self.kill()
            raise

    def order(self, line: str) -> None:
        """Send a line; a process that is gone shows in :meth:`hear`."""
        assert self._process.stdin is not None
        with contextlib.suppress(BrokenPipeError):
            self._process.stdin.write(line.encode() + b"\n")
            self._process.stdin.flush()

    def hear(self, seconds: float) -> str:
        """Return the next line that it prints.

        Raises:
            SetupError: SYS002, it has ended, or says nothing for so long.
        """
        assert self._process.stdout is not None
        descriptor = self._process.stdout.fileno()
        deadline = time.monotonic() + seconds
        parts = [self._buffer]
        with selectors.DefaultSelector() as selector:
            selector.register(descriptor, selectors.EVENT_READ)
            while b"\n" not in parts[-1]:
                if not selector.select(max(0.0, deadline - time.monotonic())):
                    raise self._error(f"it said nothing for {seconds:.0f} s")
                part = os.read(descriptor, 1 << 20)
                if not part:
                    raise self._error(self._end())
                parts.append(part)
        line, _, self._buffer = b"".join(parts).partition(b"\n")
        return line.decode(errors="replace")

    def hear_json(self, seconds: float) -> Any:
        """Return the next line, which is JSON. Raises as :meth:`hear`."""
        line = self.hear(seconds)
        try:
            return json.loads(line)
        except ValueError:
            raise self._error(f"it printed {line[:80]!r}") from None

    def cpu_seconds(self) -> float:
        """Return the processor time that all its threads have used."""
        return time.clock_gettime(self._clock)

    def close(self, seconds: float = 3.0) -> None:
        """End it: by the end of its input, or else by force; a second call does nothing."""
        assert self._process.stdin is not None and self._process.stdout is not None
        with contextlib.suppress(BrokenPipeError):
            self._process.stdin.close()
        try:
            self._process.wait(seconds)
        except subprocess.TimeoutExpired:
            self.kill()
        self._process.stdout.close()
        self._log.close()

    def kill(self) -> None:
        """End it by force, with whatever it has started."""
        with contextlib.suppress(ProcessLookupError):
            os.killpg(self.pid, signal.SIGKILL)
        self._process.wait()

    def _end(self) -> str:
        try:
            status = self._process.wait(5)
        except subprocess.TimeoutExpired:
            return "it closed its output"
        if status < 0:
            return f"it was ended by {signal.Signals(-status).name}"
        return f"it ended with status {status}"

    def _error(self, reason: str) -> SetupError:
        self._log.seek(0)
        lines = self._log.read().splitlines()[-_LAST_LINES:]
        said = "".join(f"\n  {line}" for line in lines)
        return SetupError("SYS002", f"{self._name}: {reason}{said}")


def _cpu_clock(pid: int) -> int:
    """Return the clock of a process's processor time, as clock_gettime takes it."""
    found = ctypes.c_int()
    if ctypes.CDLL(None).clock_getcpuclockid(pid, ctypes.byref(found)):
        raise SetupError("SYS002", f"the process {pid} has ended")
    return found.value


def pin(pids: Iterable[int], core: int) -> None:
    """Let all threads of processes run on one core only."""
    for pid in pids:
        for thread in Path(f"/proc/{pid}/task").iterdir():
            with contextlib.suppress(ProcessLookupError):  # a thread may have ended meanwhile
                os.sched_setaffinity(int(thread.name), {core})
