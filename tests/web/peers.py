"""What the page is tried with: typed channels, a machine's processes, and its WebSocket."""

from __future__ import annotations

import json
import subprocess
import sys
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any

from rosplc.described import description_of
from rosplc.shm import Direction, Namespace, OwnedChannel
from tests.channels import layout_of

__all__ = ["TOKEN", "WATCHDOG", "Served", "end", "layout_of", "open_typed", "page_socket", "start_role"]

TOKEN = "a-token-of-the-tests"
WATCHDOG = 60.0
_ROOT = Path(__file__).resolve().parents[2]


def open_typed(
    namespace: Namespace,
    topic: str,
    type_name: str,
    direction: Direction = Direction.TO_PLC,
    bridge: str = "cell",
) -> OwnedChannel:
    """Own a channel of a bundled type, as a bridge does."""
    layout = layout_of(type_name)
    description = description_of(layout, topic, direction, bridge=bridge)
    return OwnedChannel.open(namespace, description, record_size=layout.size)


@asynccontextmanager
async def page_socket(client: Any, wants: dict[str, Any] | None = None) -> Any:
    """Open the WebSocket as the page does, and take the server's greeting."""
    origin = str(client.make_url("/")).rstrip("/")
    async with client.ws_connect("/api/live", headers={"Origin": origin}) as socket:
        await socket.send_json({"wants": wants or {}})
        assert "hello" in await socket.receive_json()
        yield socket


class Served:
    """A ``rosplc web`` of its own process; the same port again after :meth:`restart`."""

    def __init__(self, prefix: str, *arguments: str) -> None:
        self._arguments = ["--prefix", prefix, *arguments]
        self.url, self.token, self._port = "", "", "0"
        self.process = self._start()

    def _start(self) -> subprocess.Popen[str]:
        process = subprocess.Popen(
            [sys.executable, "-m", "rosplc", "web", "--json", "--port", self._port, *self._arguments],
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            text=True,
            cwd=_ROOT,
        )
        assert process.stdout is not None
        said = json.loads(process.stdout.readline())
        self.url, self.token = said["url"], said["token"]
        self._port = self.url.rstrip("/").rpartition(":")[2]
        return process

    def restart(self) -> None:
        """Kill it, and start it again at the same address."""
        end(self.process)
        self.process = self._start()


def start_role(role: str, prefix: str, count: int = 0) -> subprocess.Popen[str]:
    """Start a process in the bridge's or the PLC's place, and wait until its channels are there."""
    child = subprocess.Popen(
        [sys.executable, "-m", "benchmarks.web_machine", role, prefix, str(count)],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
        cwd=_ROOT,
    )
    assert child.stdout is not None
    assert child.stdout.readline() == "ready\n"
    return child


def end(child: subprocess.Popen[str]) -> None:
    """Kill a process and close its pipes."""
    child.kill()
    child.wait()
    for pipe in (child.stdin, child.stdout, child.stderr):
        if pipe is not None:
            pipe.close()
