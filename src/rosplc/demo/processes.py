"""The demonstration's processes: how they are started, and the lines of JSON between them and their parent.

A child reads commands from stdin and reports on stdout. The end of stdin means that the parent has ended, for
any reason, so no child outlives a demonstration.
"""

from __future__ import annotations

import contextlib
import json
import os
import signal
import subprocess
import sys
import tempfile
import threading
from pathlib import Path
from typing import Any

from rosplc.errors import SetupError
from rosplc.shm.names import file_name

_lock = threading.Lock()


def report(kind: str, **facts: Any) -> None:
    """Send one report to the parent; a parent that is gone is noticed by :class:`Commands`."""
    line = json.dumps({"is": kind, **facts}) + "\n"
    with _lock, contextlib.suppress(BrokenPipeError, ValueError):
        sys.stdout.write(line)
        sys.stdout.flush()


class Commands:
    """The parent's commands as events: ``go``, ``drain``, ``stop``, and ``others`` that are named.

    Constructing it makes the process deaf to Ctrl-C, which a terminal sends to the whole group: the parent
    decides what ends when.
    """

    def __init__(self, *others: str) -> None:
        signal.signal(signal.SIGINT, signal.SIG_IGN)
        signal.signal(signal.SIGTERM, lambda *_: self.stop.set())
        self.go = threading.Event()
        self.drain = threading.Event()
        self.stop = threading.Event()
        self.others = {word: threading.Event() for word in others}
        threading.Thread(target=self._listen, name="commands", daemon=True).start()

    def _listen(self) -> None:
        events = {"go": self.go, "drain": self.drain, "stop": self.stop, **self.others}
        for line in sys.stdin:
            if (event := events.get(line.strip())) is not None:
                event.set()
        self.stop.set()


_LAST_LINES = 15


class Child:
    """A process that runs a module, with commands going in and reports coming out.

    ``role`` is what people call it: robot, bridge or PLC; ``status`` its last report.
    """

    def __init__(self, role: str, module: str, arguments: list[str], environment: dict[str, str]) -> None:
        self.role = role
        self.status: dict[str, Any] = {}
        self._error: dict[str, str] | None = None
        self._log = tempfile.TemporaryFile("w+", errors="replace")  # noqa: SIM115 - closed in close()
        # Its own session: Ctrl-C reaches the supervisor alone, which then ends the others in order.
        self._process = subprocess.Popen(
            [sys.executable, "-m", module, *arguments],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=self._log,
            text=True,
            env=environment,
            start_new_session=True,
        )
        self._reader = threading.Thread(target=self._read, name=f"read-{role}", daemon=True)
        self._reader.start()

    @property
    def pid(self) -> int:
        """Its process id."""
        return self._process.pid

    def order(self, word: str) -> None:
        """Send an order; a process that is gone shows in :meth:`check`."""
        assert self._process.stdin is not None
        with contextlib.suppress(BrokenPipeError, ValueError):
            self._process.stdin.write(word + "\n")
            self._process.stdin.flush()

    def check(self) -> None:
        """Raise SetupError SYS002, with its own error or its last output, if the process has ended."""
        status = self._process.poll()
        if status is None:
            return
        self._reader.join(1.0)
        if self._error is not None:
            reason = f"{self._error['what']} [{self._error['code']}] {self._error['remedy']}"
        elif status < 0:
            reason = f"it was killed by signal {signal.Signals(-status).name}"
        else:
            reason = f"it exited with status {status}"
        self._log.seek(0)
        output = "".join(f"\n  {self.role}: {line}" for line in self._log.read().splitlines()[-_LAST_LINES:])
        again = "Run the demo again; if the problem persists, the message above shows which part fails."
        what = f"the {self.role} process failed: {reason}{output}"
        raise SetupError("SYS002", what, remedy="" if output else again)

    def kill(self) -> None:
        """End it as a crash would (SIGKILL), and wait until it is gone."""
        os.killpg(self._process.pid, signal.SIGKILL)
        self._process.wait()

    def finish(self, seconds: float = 5.0) -> None:
        """Tell it to stop and wait; kill it if it does not within ``seconds``."""
        self.order("stop")
        assert self._process.stdin is not None
        with contextlib.suppress(BrokenPipeError):
            self._process.stdin.close()
        try:
            self._process.wait(seconds)
        except subprocess.TimeoutExpired:
            self.kill()
        self._reader.join(1.0)

    def close(self) -> None:
        """Let go of its log; its pipe is closed once all of it was read."""
        self._log.close()

    def _read(self) -> None:
        assert self._process.stdout is not None
        with self._process.stdout as lines:
            for line in lines:
                try:
                    facts = json.loads(line)
                except ValueError:
                    continue
                if facts.pop("is", "") == "error":
                    self._error = facts
                else:
                    self.status = facts


def remove_objects(prefix: str, directory: str = "/dev/shm") -> int:
    """Remove the objects and lock files of ``prefix`` and return how many there were.

    Only for a prefix that was made up for this run: a running bridge's objects must never be removed by
    others (spec/shm-format.md, M5).
    """
    removed = 0
    for path in Path(directory).glob(f"{prefix}.*"):
        if file_name(path.name) is not None:
            with contextlib.suppress(FileNotFoundError):
                path.unlink()
                removed += 1
    return removed
