"""A process of the cell: started, killed, stopped, looked at."""

from __future__ import annotations

import contextlib
import ctypes
import os
import signal
import subprocess
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

from tests.soak.nursery import Forked, Nursery

__all__ = ["Part", "Usage"]

_LIBC = ctypes.CDLL(None)
_PR_SET_PDEATHSIG = 1


@dataclass(frozen=True)
class Usage:
    """What a process holds.

    Attributes:
        pid: The process.
        files: Open descriptors.
        threads: Threads.
        rss_kb: Resident memory.
        private_kb: Resident memory that is its own: pages of code and of shared memory left out.
    """

    pid: int
    files: int
    threads: int
    rss_kb: int
    private_kb: int


def _prepare() -> None:
    """In the child: die with the campaign, and heed SIGHUP though nohup may have started the campaign."""
    _LIBC.prctl(_PR_SET_PDEATHSIG, signal.SIGKILL)
    signal.signal(signal.SIGHUP, signal.SIG_DFL)


class Part:
    """One process that is started again whenever it has ended.

    Args:
        name: What it is.
        command: Returns its command line, for each start.
        environment: Its environment.
        log: Where its output goes.
        nursery: Forks it, where it is given; else it is executed.

    Attributes:
        lives: How often it was started.
        through: A module of Python that the next processes are started through; none if it is empty. They
            are executed.
    """

    def __init__(
        self,
        name: str,
        command: Callable[[], list[str]],
        environment: Mapping[str, str],
        log: Path,
        nursery: Nursery | None = None,
    ) -> None:
        self.name = name
        self.lives = 0
        self.through = ""
        self.environment = dict(environment)
        self.log = log
        self._command = command
        self._nursery = nursery
        self._process: subprocess.Popen[bytes] | Forked | None = None
        self._marked = 0

    @property
    def pid(self) -> int:
        """The process id; 0 while there is none."""
        return 0 if self._process is None else self._process.pid

    @property
    def alive(self) -> bool:
        """Whether it runs (or is stopped)."""
        return self._process is not None and self._process.poll() is None

    @property
    def status(self) -> int | None:
        """How it ended; None while it runs."""
        return None if self._process is None else self._process.poll()

    def start(self) -> None:
        """Start it."""
        self.lives += 1
        command = self._command()
        if self._nursery is not None and not self.through:
            _, _, module, *arguments = command  # python -m MODULE …
            self._process = self._nursery.fork(module, arguments, self.log)
            return
        if self.through:
            command.insert(command.index("-m") + 1, self.through)
        with self.log.open("ab") as log:
            self._process = subprocess.Popen(
                command,
                env=self.environment,
                stdin=subprocess.DEVNULL,
                stdout=log,
                stderr=log,
                preexec_fn=_prepare,
            )

    def mark(self) -> None:
        """Note where the log stands: what is told from here on belongs to a new round."""
        self._marked = self.log.stat().st_size if self.log.exists() else 0

    def told(self) -> str:
        """Return the log since the mark."""
        if not self.log.exists():
            return ""
        with self.log.open("rb") as log:
            log.seek(self._marked)
            return log.read().decode(errors="replace")

    def send(self, number: signal.Signals) -> None:
        """Send a signal."""
        if self.alive:
            os.kill(self.pid, number)

    def kill(self) -> None:
        """End it with kill -9."""
        self.send(signal.SIGKILL)
        if self._process is not None:
            self._process.wait()

    def terminate(self, seconds: float = 60.0) -> bool:
        """Ask it to end; return whether it did in time, else it is killed."""
        self.send(signal.SIGTERM)
        if self._process is None:
            return True
        with contextlib.suppress(subprocess.TimeoutExpired):
            self._process.wait(seconds)
            return True
        self.kill()
        return False

    def usage(self) -> Usage | None:
        """Return what it holds; None if it has ended."""
        root = Path(f"/proc/{self.pid}")
        try:
            status = dict(
                line.split(":", 1) for line in (root / "status").read_text().splitlines() if ":" in line
            )
            files = len(os.listdir(root / "fd"))
            return Usage(
                self.pid,
                files,
                int(status["Threads"]),
                int(status["VmRSS"].split()[0]),
                int(status["RssAnon"].split()[0]),
            )
        except (OSError, KeyError, ValueError):
            return None
