"""Routers for tests, each at a port that nobody else has."""

from __future__ import annotations

import contextlib
import socket
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

_HERE = Path(__file__).parent


@contextlib.contextmanager
def free_port() -> Iterator[int]:
    """Give a TCP port on 127.0.0.1 that nobody else is given meanwhile.

    A socket that is bound and does not listen keeps the port from being given away, and lets a
    child process listen on it, since both allow the address to be reused.
    """
    with socket.socket() as holder:
        holder.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        holder.bind(("127.0.0.1", 0))
        yield holder.getsockname()[1]


class Router:
    """A router's process; it may be killed and started again at the same port.

    Args:
        port: Where it listens on 127.0.0.1.
        connect: Endpoints of other routers.
        prefix: A command in front, such as ``env PYTHONPATH=FOLDER`` for another version of the wheel.
    """

    def __init__(self, port: int, *connect: str, prefix: tuple[str, ...] = ()) -> None:
        self.port = port
        self.endpoint = f"tcp/127.0.0.1:{port}"
        self._command = [*prefix, sys.executable, str(_HERE / "router.py"), self.endpoint, *connect]
        self._process: subprocess.Popen[str] | None = None

    def start(self) -> None:
        """Start it, and wait until it listens."""
        self._process = subprocess.Popen(
            self._command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
        )
        assert self._process.stdout is not None
        if not self._process.stdout.readline().startswith("ready"):
            self.kill()
            raise RuntimeError(f"the router at {self.endpoint} did not start")

    def kill(self) -> None:
        """End it without a goodbye."""
        if self._process is not None:
            self._process.kill()
            self._process.communicate()
            self._process = None

    def __enter__(self) -> Router:
        self.start()
        return self

    def __exit__(self, *_: object) -> None:
        self.kill()
