"""What stands beside a bridge while its views are measured: the views themselves, and a busy PLC without ROS.

    python -m benchmarks.view_peers feeder|page ORDERS_JSON

``feeder`` owns channels and publishes on all of them at a rate, in turns of a millisecond; ``page`` is what
an open browser page is to `rosplc web`: it asks for the overview, a message and plots, and reads every
frame. Both say ``ready`` in a line of JSON, and end with their standard input.
"""

from __future__ import annotations

import asyncio
import fcntl
import json
import os
import pty
import struct
import subprocess
import sys
import termios
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from benchmarks.load_peers import STRING, TYPE, Orders, names, paced, patterns, say
from benchmarks.processes import Peer
from rosplc.described import description_of
from rosplc.layout import Limits, compute_layout
from rosplc.model import TypeStore
from rosplc.shm import Direction, Namespace, OwnedChannel

__all__ = ["VIEWS", "View", "recorder", "view"]

VIEWS = ("nothing", "rosplc top", "rosplc web, no page", "rosplc web, a page", "rosplc record")


def feeder(order: dict[str, Any]) -> None:
    """Publish on channels of its own."""
    layout = compute_layout(TypeStore.bundled("jazzy"), TYPE, Limits(string=STRING))
    _, records = patterns()
    orders = Orders()
    owned = []
    for index, topic in enumerate(names("in", order["topics"])):
        description = description_of(layout, topic, Direction.TO_PLC, bridge="feeder")
        channel = OwnedChannel.open(
            Namespace(order["prefix"]), description, record_size=layout.size, slots=order["slots"]
        )
        owned.append((channel, channel.writer(), records(index)))
    say(ready=True)
    orders.go.wait()
    number, began = 0, time.monotonic()

    def turn() -> None:
        nonlocal number
        while number < (time.monotonic() - began) * order["rate"] and number < order["count"]:
            number += 1
            for _, writer, pattern in owned:
                writer.publish(pattern.of(number))
        if number == order["count"]:
            orders.stop.set()

    paced(0.001, orders, turn)
    say(sent=number, seconds=time.monotonic() - began)
    threading.Event().wait()  # the channels stay until their reader has read them


def page(order: dict[str, Any]) -> None:
    """Be a page that is open."""
    import aiohttp

    async def look() -> None:
        async with (
            aiohttp.ClientSession() as session,
            session.ws_connect(order["url"] + "api/live", origin=order["url"].rstrip("/")) as socket,
        ):
            one = order["channel"]
            await socket.send_json({"wants": {"messages": [one], "plots": {one: ["pose.position.x"]}}})
            await socket.receive_json()
            say(ready=True)
            async for message in socket:
                json.loads(message.data)

    threading.Thread(target=lambda: (sys.stdin.read(), os._exit(0)), daemon=True).start()
    asyncio.run(look())


@dataclass
class View:
    """A view that runs: the process to measure, 0 for none, and what it said at its end."""

    pid: int = 0
    facts: dict[str, Any] | None = None


@contextmanager
def view(kind: str, prefix: str, folder: Path, domain: int) -> Iterator[View]:
    """Run a view beside a bridge."""
    found = View()
    if kind == "nothing":
        yield found
    elif kind == "rosplc top":
        with _terminal(["top", "--prefix", prefix]) as found.pid:
            yield found
    elif kind == "rosplc record":
        out = folder / "record.mcap"
        out.unlink(missing_ok=True)
        with recorder(prefix, out) as process:
            found.pid = process.pid
            yield found
            process.terminate()
            found.facts = json.loads(process.communicate()[0])
    else:
        with _process(["web", "--prefix", prefix, "--port", "0", "--json"]) as process:
            found.pid = process.pid
            assert process.stdout is not None
            url = json.loads(process.stdout.readline())["url"]
            if kind == "rosplc web, no page":
                yield found
            else:
                order = {"url": url, "channel": f"{prefix}.t.load.in_0"}
                with Peer("view_peers", "page", order, domain) as client:
                    client.hear()
                    yield found


@contextmanager
def recorder(prefix: str, out: Path) -> Iterator[subprocess.Popen[str]]:
    """Run a recorder; it has begun when the block begins, and says what it did when it is terminated."""
    arguments = ["record", "--prefix", prefix, "-o", str(out), "--json"]
    with _process(arguments, errors=subprocess.PIPE) as process:
        assert process.stderr is not None
        while "Ctrl-C" not in (line := process.stderr.readline()):
            if not line:
                raise RuntimeError("the recorder ended")
        yield process


@contextmanager
def _process(arguments: list[str], errors: int = subprocess.DEVNULL) -> Iterator[subprocess.Popen[str]]:
    process = subprocess.Popen(
        [sys.executable, "-m", "rosplc", *arguments],
        stdout=subprocess.PIPE,
        stderr=errors,
        text=True,
    )
    try:
        yield process
    finally:
        if process.poll() is None:
            process.kill()
            process.communicate()


@contextmanager
def _terminal(arguments: list[str]) -> Iterator[int]:
    """Run a program in a terminal of 120 columns, whose output somebody reads."""
    ours, theirs = pty.openpty()
    fcntl.ioctl(theirs, termios.TIOCSWINSZ, struct.pack("4H", 40, 120, 0, 0))
    process = subprocess.Popen(
        [sys.executable, "-m", "rosplc", *arguments],
        stdin=theirs,
        stdout=theirs,
        stderr=theirs,
        env={**os.environ, "TERM": "xterm-256color"},
    )
    os.close(theirs)

    drawn = threading.Event()

    def read() -> None:
        try:
            while os.read(ours, 65536):
                drawn.set()
        except OSError:
            pass  # the program has ended

    reader = threading.Thread(target=read, daemon=True)
    reader.start()
    try:
        drawn.wait(60)
        yield process.pid
        if process.poll() is not None:
            raise RuntimeError(f"{arguments} ended with status {process.returncode}")
    finally:
        process.kill()
        process.wait()
        os.close(ours)


if __name__ == "__main__":
    {"feeder": feeder, "page": page}[sys.argv[1]](json.loads(sys.argv[2]))
