"""Processes that are forked from one that is ready behave as those that are executed."""

from __future__ import annotations

import os
import signal
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.soak.messages import Counters
from tests.soak.processes import ForkServer, Part


@pytest.fixture
def plc(tmp_path: Path) -> Iterator[Part]:
    """Give a PLC that finds no bridge, started from a fork server."""
    Counters(tmp_path / "counters", create=True)
    environment = {**os.environ, "PYTHONPATH": str(Path(__file__).resolve().parents[3])}
    fork_server = ForkServer(environment, "memory", ["tests.soak.plc"])
    command = ["python", "-m", "tests.soak.plc", str(tmp_path / "counters"), "1", "nobody"]
    part = Part("plc", lambda: command, environment, tmp_path / "plc.log", fork_server)
    yield part
    part.kill()
    fork_server.close()


def scans(part: Part, counters: Counters) -> None:
    """Wait until the PLC runs scans."""
    before = int(counters.control["plc_scans"])
    while counters.control["plc_scans"] <= before:
        assert part.alive, part.log.read_text()
        time.sleep(0.01)


def test_each_start_is_a_process_of_its_own(plc: Part, tmp_path: Path) -> None:
    """It is a child of this process, runs, ends by kill -9 or in order, and starts again as another."""
    counters = Counters(tmp_path / "counters")
    seen = set()
    for end in (plc.kill, plc.terminate):
        plc.start()
        scans(plc, counters)
        seen.add(plc.pid)
        assert Path(f"/proc/{plc.pid}/stat").read_text().rpartition(")")[2].split()[1] == str(os.getpid())
        end()
        assert not plc.alive
    assert len(seen) == 2
    assert plc.status == 0, plc.log.read_text()


def test_what_fails_is_logged(plc: Part, tmp_path: Path) -> None:
    """An error ends the process with status 1, and its trace is in the log."""
    part = plc
    part._command = lambda: ["python", "-m", "tests.soak.plc", str(tmp_path / "nowhere"), "1", "nobody"]
    part.start()
    while part.alive:
        time.sleep(0.01)
    assert part.status == 1
    assert "FileNotFoundError" in part.log.read_text()
    assert part.told() == part.log.read_text()
    part.send(signal.SIGTERM)  # to one that has ended: nothing happens
