"""Processes that take requests line by line and answer likewise: the parent's side and the child's."""

from __future__ import annotations

import asyncio
import contextlib
import ctypes
import json
import os
import selectors
import signal
import socket
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from types import TracebackType
from typing import Any

from rosplc.errors import SetupError

WATCHDOG_S = 60.0
_LAST_LINES = 12
_PR_SET_PDEATHSIG = 1


class Side:
    """A running process, and a context manager that ends it.

    Args:
        name: Its name in messages.
        command: Its command line.
        environment: Its environment; by default this process's.

    Attributes:
        pid: Its process id.
    """

    def __init__(
        self, name: str, command: Sequence[str], environment: Mapping[str, str] | None = None
    ) -> None:
        self._name = name
        self._log = tempfile.TemporaryFile("w+", errors="replace")  # noqa: SIM115 - closed in close()
        # Its own session: Ctrl-C reaches this process alone, which then ends the others.
        self._process = subprocess.Popen(
            [*command],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=self._log,
            env=environment,
            start_new_session=True,
        )
        self.pid = self._process.pid
        self._buffer = b""
        try:
            self._clock = cpu_clock(self.pid)
        except BaseException:  # nothing else would end it
            self.kill()
            raise

    def send(self, line: str) -> None:
        """Send a line; a process that has ended shows in :meth:`receive`."""
        assert self._process.stdin is not None
        with contextlib.suppress(BrokenPipeError):
            self._process.stdin.write(line.encode() + b"\n")
            self._process.stdin.flush()

    def receive(self, seconds: float = WATCHDOG_S) -> str:
        """Return the next line that it prints.

        Raises:
            SetupError: SYS002, it has ended, or printed nothing for so long.
        """
        assert self._process.stdout is not None
        descriptor = self._process.stdout.fileno()
        deadline = time.monotonic() + seconds
        parts = [self._buffer]
        with selectors.DefaultSelector() as selector:
            selector.register(descriptor, selectors.EVENT_READ)
            while b"\n" not in parts[-1]:
                if not selector.select(max(0.0, deadline - time.monotonic())):
                    raise self._error(f"no output for {seconds:.0f} s")
                part = os.read(descriptor, 1 << 20)
                if not part:
                    raise self._error(self._end())
                parts.append(part)
        line, _, self._buffer = b"".join(parts).partition(b"\n")
        return line.decode(errors="replace")

    def receive_json(self, seconds: float = WATCHDOG_S) -> Any:
        """Return the next line, which is JSON. Raises as :meth:`receive`."""
        line = self.receive(seconds)
        try:
            return json.loads(line)
        except ValueError:
            raise self._error(f"it printed {line[:80]!r}") from None

    def ask(self, request: str | None = None, /, **fields: Any) -> Any:
        """Send text, or else ``fields`` as JSON, and return the answer. Raises as :meth:`receive`."""
        self.send(json.dumps(fields) if request is None else request)
        return self.receive_json()

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

    def __enter__(self) -> Side:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def _end(self) -> str:
        try:
            status = self._process.wait(5)
        except subprocess.TimeoutExpired:
            return "it closed its output"
        if status < 0:
            return f"it was killed by {signal.Signals(-status).name}"
        return f"it exited with status {status}"

    def _error(self, reason: str) -> SetupError:
        self._log.seek(0)
        lines = self._log.read().splitlines()[-_LAST_LINES:]
        return SetupError("SYS002", "\n  ".join([f"{self._name}: {reason}", *lines]))


def cpu_clock(pid: int) -> int:
    """Return the clock of a process's processor time, as clock_gettime takes it."""
    found = ctypes.c_int()
    if ctypes.CDLL(None).clock_getcpuclockid(pid, ctypes.byref(found)):
        raise SetupError("SYS002", f"process {pid} has ended")
    return found.value


def pin(pids: Iterable[int], *cores: int) -> None:
    """Let all threads of processes run on these cores only."""
    for pid in pids:
        for thread in Path(f"/proc/{pid}/task").iterdir():
            with contextlib.suppress(ProcessLookupError):  # a thread may have ended meanwhile
                os.sched_setaffinity(int(thread.name), cores)


def free_port() -> int:
    """Return a port that was free a moment ago."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


def python(module: str, *arguments: str, without: tuple[str, ...] = (), **variables: str) -> list[str]:
    """Return the command line of one of this package's modules, in an environment that differs so."""
    # No module in the current folder takes a library's place (from Python 3.11 on).
    changed = {"PYTHONSAFEPATH": "1", **variables}
    unset = [word for name in without for word in ("-u", name)]
    settings = [f"{name}={value}" for name, value in changed.items()]
    return ["env", *unset, *settings, sys.executable, "-m", f"rosplc_bench.{module}", *arguments]


# In the child


def reply(**facts: Any) -> None:
    """Answer the parent."""
    sys.stdout.write(json.dumps(facts) + "\n")
    sys.stdout.flush()


def follow_parent() -> None:
    """Leave Ctrl-C to the parent, and have the kernel end this process when the parent is gone."""
    ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, int(signal.SIGKILL))
    signal.signal(signal.SIGINT, signal.SIG_IGN)


def requests() -> Iterator[dict[str, Any]]:
    """Yield the requests that come in, until the input ends."""
    follow_parent()
    for line in sys.stdin:
        yield json.loads(line)


def in_background(
    serve: Callable[[Callable[[], None]], Any], seconds: float = WATCHDOG_S
) -> threading.Thread:
    """Run an event loop in a thread; return once ``serve`` has called what it is given: it is ready.

    Raises:
        TimeoutError: It is not ready in ``seconds``.
    """
    ready = threading.Event()
    failed: list[BaseException] = []

    def run() -> None:
        try:
            asyncio.run(serve(ready.set))
        except BaseException as error:
            failed.append(error)
            ready.set()

    thread = threading.Thread(target=run, name="loop", daemon=True)
    thread.start()
    if not ready.wait(seconds):
        raise TimeoutError("the event loop is not ready")
    if failed:
        raise failed[0]
    return thread
