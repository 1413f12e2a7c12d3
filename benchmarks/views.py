"""The views of a bridge as processes: `rosplc top`, `rosplc web` with or without a page, `rosplc record`."""

from __future__ import annotations

import fcntl
import json
import os
import pty
import struct
import subprocess
import sys
import termios
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from benchmarks.processes import peers
from rosplc_bench.process import Side

__all__ = ["VIEWS", "View", "recorder", "rosplc", "view", "web"]

VIEWS = ("nothing", "rosplc top", "rosplc web, no page", "rosplc web, a page", "rosplc record")


@dataclass
class View:
    """A view that runs: the process to measure, 0 for none, and what it printed at its end."""

    pid: int = 0
    facts: dict[str, Any] | None = None


@contextmanager
def view(kind: str, prefix: str, folder: Path, domain: int) -> Iterator[View]:
    """Run a view beside a bridge."""
    found = View()
    if kind == "nothing":
        yield found
    elif kind == "rosplc top":
        with _terminal("top", "--prefix", prefix) as found.pid:
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
        with web(prefix) as (url, found.pid):
            if kind == "rosplc web, no page":
                yield found
            else:
                plan = {"url": url, "channel": f"{prefix}.t.load.in_0"}
                with peers("page", plan, domain):
                    yield found


def rosplc(*arguments: str) -> list[str]:
    """Return a command line of rosplc."""
    return [sys.executable, "-m", "rosplc", *arguments]


@contextmanager
def web(prefix: str) -> Iterator[tuple[str, int]]:
    """Run ``rosplc web``; give its address and process."""
    with Side("web", rosplc("web", "--prefix", prefix, "--port", "0", "--json")) as server:
        try:
            yield server.receive_json()["url"], server.pid
        finally:
            server.kill()


@contextmanager
def recorder(prefix: str, out: Path) -> Iterator[subprocess.Popen[str]]:
    """Run a recorder; it has begun when the block begins, and prints what it did when it is terminated."""
    command = rosplc("record", "--prefix", prefix, "-o", str(out), "--json")
    pipe = subprocess.PIPE
    with subprocess.Popen(command, stdout=pipe, stderr=pipe, text=True) as process:
        try:
            assert process.stderr is not None
            while "Ctrl-C" not in (line := process.stderr.readline()):
                if not line:
                    raise RuntimeError("the recorder ended")
            yield process
        finally:
            process.kill()


@contextmanager
def _terminal(*arguments: str) -> Iterator[int]:
    """Run a program in a terminal of 120 columns, whose output is read."""
    ours, theirs = pty.openpty()
    fcntl.ioctl(theirs, termios.TIOCSWINSZ, struct.pack("4H", 40, 120, 0, 0))
    environment = {**os.environ, "TERM": "xterm-256color"}
    process = subprocess.Popen(
        rosplc(*arguments), stdin=theirs, stdout=theirs, stderr=theirs, env=environment
    )
    os.close(theirs)
    drawn = threading.Event()

    def read() -> None:
        try:
            while os.read(ours, 65536):
                drawn.set()
        except OSError:
            pass  # the program has ended

    threading.Thread(target=read, daemon=True).start()
    try:
        drawn.wait(60)
        yield process.pid
        if process.poll() is not None:
            raise RuntimeError(f"{arguments} ended with status {process.returncode}")
    finally:
        process.kill()
        process.wait()
        os.close(ours)
