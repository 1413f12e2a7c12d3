"""A process that has imported everything, and forks the PLC and the ROS nodes from itself when asked to.

A Python program takes most of a second of a processor to start, and a campaign starts thousands. What is
forked here is a process of its own like any other, with its own log, and killed with the same signals; it
only begins where its imports have ended. The bridge, which is what is tested, is never started like this.
"""

from __future__ import annotations

import ctypes
import importlib
import json
import os
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Mapping, Sequence
from pathlib import Path

from tests.soak.pattern import wire_codec

__all__ = ["Forked", "Nursery"]

_LIBC = ctypes.CDLL(None)
_PR_SET_PDEATHSIG, _PR_SET_CHILD_SUBREAPER = 1, 36
_MOST = 1 << 16
_LOOK_S = 0.005


class Forked:
    """A process that the nursery has forked; a child of the campaign, with what it needs of Popen."""

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


class Nursery:
    """The campaign's side: starts the nursery and asks it for processes.

    Args:
        environment: What all processes have.
        backend: The ROS side, imported before.
        modules: Modules that processes are started from, each with a ``main``.
    """

    def __init__(self, environment: Mapping[str, str], backend: str, modules: Sequence[str]) -> None:
        # What the nursery forks becomes a child of this process when its own parent has ended.
        _LIBC.prctl(_PR_SET_CHILD_SUBREAPER, 1)
        self._socket, other = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        with other:
            self._process = subprocess.Popen(
                [sys.executable, "-m", "tests.soak.nursery", str(other.fileno()), backend, *modules],
                env=dict(environment),
                stdin=subprocess.DEVNULL,
                pass_fds=[other.fileno()],
            )

    def fork(self, module: str, arguments: Sequence[str], log: Path) -> Forked:
        """Start a process; its output goes to the end of the log.

        Raises:
            OSError: The nursery has ended.
        """
        self._socket.sendall(json.dumps([module, *arguments, str(log)]).encode())
        answer = self._socket.recv(_MOST)
        if not answer:
            raise OSError("the nursery has ended")
        return Forked(int(answer))

    def close(self) -> None:
        """End the nursery; what it has forked goes on."""
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


if __name__ == "__main__":
    main()
