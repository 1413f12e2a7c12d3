"""A process that has imported everything, and forks the PLC and the ROS nodes from itself when asked to.

A Python program takes most of a second of a processor to start, and a campaign starts thousands. What is
forked here is a process of its own like any other, with its own log, and killed with the same signals; it
only begins where its imports have ended. The bridge, which is what is tested, is never started like this.
"""

from __future__ import annotations

import contextlib
import ctypes
import importlib
import json
import os
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from tests.soak.messages import wire_codec

_LIBC = ctypes.CDLL(None)
_PR_SET_PDEATHSIG, _PR_SET_CHILD_SUBREAPER = 1, 36
_MOST = 1 << 16
_LOOK_S = 0.005


class Forked:
    """A process that the fork server has forked; a child of the campaign, with what it needs of Popen."""

    def __init__(self, pid: int) -> None:
        self.pid = pid
        self._status: int | None = None

    def poll(self) -> int | None:
        """Return how it has ended, as Popen does; None while it runs."""
        if self._status is None:
            pid, status = os.waitpid(self.pid, os.WNOHANG)
            if pid:
                self._status = os.waitstatus_to_exitcode(status)
        return self._status

    def wait(self, timeout: float | None = None) -> int:
        """Wait for its end; subprocess.TimeoutExpired if it has not come in time."""
        deadline = None if timeout is None else time.monotonic() + timeout
        while (status := self.poll()) is None:
            if deadline is not None and time.monotonic() > deadline:
                raise subprocess.TimeoutExpired([], timeout or 0.0)
            time.sleep(_LOOK_S)
        return status


class ForkServer:
    """The campaign's side: starts the fork server and asks it for processes.

    Args:
        environment: What all processes have.
        backend: The ROS side, imported before.
        modules: Modules that processes are started from, each with a ``main``.
    """

    def __init__(self, environment: Mapping[str, str], backend: str, modules: Sequence[str]) -> None:
        # What the fork server forks becomes a child of this process when its own parent has ended.
        _LIBC.prctl(_PR_SET_CHILD_SUBREAPER, 1)
        self._socket, other = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        with other:
            self._process = subprocess.Popen(
                [sys.executable, "-m", "tests.soak.processes", str(other.fileno()), backend, *modules],
                env=dict(environment),
                stdin=subprocess.DEVNULL,
                pass_fds=[other.fileno()],
            )

    def fork(self, module: str, arguments: Sequence[str], log: Path) -> Forked:
        """Start a process; its output goes to the end of the log.

        Raises:
            OSError: The fork server has ended.
        """
        self._socket.sendall(json.dumps([module, *arguments, str(log)]).encode())
        answer = self._socket.recv(_MOST)
        if not answer:
            raise OSError("the fork server has ended")
        return Forked(int(answer))

    def close(self) -> None:
        """End the fork server; what it has forked continues."""
        self._socket.close()
        self._process.kill()
        self._process.wait()
        _LIBC.prctl(_PR_SET_CHILD_SUBREAPER, 0)  # this process may be one of tests, which has other children


def _serve(requests: socket.socket, campaign: int) -> None:
    reading, writing = os.pipe()
    while order := requests.recv(_MOST):
        module, *arguments, log = json.loads(order)
        between = os.fork()
        if between == 0:
            child = os.fork()
            if child:
                os.write(writing, child.to_bytes(4, "little"))
                os._exit(0)
            os.close(reading)
            os.close(writing)
            _become(requests, campaign, module, arguments, log)
        # Only when the process between has ended is the child the campaign's, to be waited for.
        os.waitpid(between, 0)
        requests.sendall(str(int.from_bytes(os.read(reading, 4), "little")).encode())


def _become(requests: socket.socket, campaign: int, module: str, arguments: list[str], log: str) -> None:
    status = 1
    try:
        requests.close()
        while os.getppid() != campaign:  # until then, the end of the process between would count as ours
            time.sleep(0.001)
        _LIBC.prctl(_PR_SET_PDEATHSIG, signal.SIGKILL)
        output = os.open(log, os.O_WRONLY | os.O_APPEND | os.O_CREAT, 0o644)
        os.dup2(output, 1)
        os.dup2(output, 2)
        os.close(output)
        sys.argv = [module, *arguments]
        importlib.import_module(module).main()
        status = 0
    except BaseException:
        sys.excepthook(*sys.exc_info())
    finally:
        sys.stdout.flush()
        sys.stderr.flush()
        os._exit(status)


def main() -> None:
    """Import what is named, then serve: arguments are a socket, the backend and modules."""
    from rosplc.model import TypeStore

    number, backend, *modules = sys.argv[1:]
    campaign = os.getppid()
    _LIBC.prctl(_PR_SET_PDEATHSIG, signal.SIGKILL)
    signal.signal(signal.SIGHUP, signal.SIG_DFL)
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    for module in (*modules, f"rosplc.ros.{backend}"):
        importlib.import_module(module)
    wire_codec(TypeStore.bundled("noetic" if backend == "rospy" else "jazzy"))
    _serve(socket.socket(fileno=int(number)), campaign)


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


def proc_status(pid: int) -> dict[str, str]:
    """Return what the kernel says of a process; OSError if it has ended."""
    lines = Path(f"/proc/{pid}/status").read_text().splitlines()
    return {name: value.strip() for name, _, value in (line.partition(":") for line in lines)}


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
        fork_server: Forks it, where it is given; else it is executed.

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
        fork_server: ForkServer | None = None,
    ) -> None:
        self.name = name
        self.lives = 0
        self.through = ""
        self.environment = dict(environment)
        self.log = log
        self._command = command
        self._fork_server = fork_server
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
        if self._fork_server is not None and not self.through:
            _, _, module, *arguments = command  # python -m MODULE …
            self._process = self._fork_server.fork(module, arguments, self.log)
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

    def replace(self) -> None:
        """End it with kill -9, and start it again."""
        self.kill()
        self.start()

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
        try:
            status, files = proc_status(self.pid), len(os.listdir(f"/proc/{self.pid}/fd"))
            held = (int(status[key].split()[0]) for key in ("Threads", "VmRSS", "RssAnon"))
            return Usage(self.pid, files, *held)
        except (OSError, KeyError, ValueError):
            return None


if __name__ == "__main__":
    main()
