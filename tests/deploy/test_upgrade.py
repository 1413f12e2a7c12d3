"""A newer bridge takes the place of an older one, and back, while PLC and ROS nodes go on."""

from __future__ import annotations

import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from deploy.wheel import PIP, build_wheel, project_version, run
from rosplc.shm import attach
from tests.soak.cell import Cell
from tests.soak.messages import OUT, TOPICS

NEWER = "99.0"
WATCHDOG_S = 120.0


@pytest.fixture(scope="module")
def versions(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """Give two versions of rosplc, each installed from its wheel into a folder of its own."""
    folder = tmp_path_factory.mktemp("versions")
    found = {}
    for version in (project_version(), NEWER):
        wheel = build_wheel(folder / f"wheel-{version}", version=version)
        found[version] = folder / version
        # What they stand on is this environment's.
        run([*PIP, "install", "--quiet", "--no-deps", "--target", found[version], wheel])
    return found


@pytest.fixture(params=["python", "st"])
def cell(request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[Cell]:
    pytest.importorskip("cyclonedds")
    if request.param == "st":
        pytest.importorskip("blark")
    cell = Cell(tmp_path, "dds", private=False, plc=request.param)
    yield cell
    cell.close()


def become(cell: Cell, place: Path) -> None:
    """Let the cell's bridge be the version in a folder, from its next start on."""
    cell.parts["bridge"].environment["PYTHONPATH"] = str(place)


def generations(cell: Cell) -> list[int]:
    """Return what tells a new object at a topic's name from the one that was there."""
    found = []
    for topic in TOPICS:
        with attach(cell.namespace, topic) as channel:
            found.append(channel.identity.generation)
    return found


def beside(pid: int) -> str:
    """Return which rosplc a process has loaded."""
    maps = Path(f"/proc/{pid}/maps").read_text()
    return next(line.split()[-1] for line in maps.splitlines() if "rosplc/_core/" in line)


def waiting(cell: Cell) -> tuple[int, int]:
    """Return how far the bridge has taken the topic of which it takes every message, and the newest."""
    with attach(cell.namespace, OUT[0]) as channel:
        seen = channel.snapshot()
        return seen.readers[0].taken, seen.writer.head


def account(cell: Cell, taken_before: int) -> int:
    """Check that the bridge has counted every message since another one's last; return how many were lost."""
    topic = cell.topics.index(OUT[0])
    plc = cell.parts["plc"]
    plc.send(signal.SIGSTOP)
    cell.wait(lambda: len(set(waiting(cell))) == 1, "the bridge takes what is left")
    cell.await_diagnostics()
    taken, _ = waiting(cell)
    count = cell.counters.bridge[topic]
    plc.send(signal.SIGCONT)
    assert int(count["received"] + count["lost"]) == taken - taken_before
    return int(count["lost"])


@pytest.mark.verify(minutes=1)
@pytest.mark.timeout(1800)
def test_bridges_change_places_under_load(cell: Cell, versions: dict[str, Path]) -> None:
    """Forth and back: objects stay, the PLC goes on, nothing is torn or invented, and losses are counted."""
    become(cell, versions[project_version()])
    cell.start()
    objects, plc = generations(cell), cell.parts["plc"].pid
    bridge = cell.parts["bridge"]
    for swaps, version in enumerate((NEWER, project_version()), 1):
        assert bridge.terminate(WATCHDOG_S) and bridge.status == 0
        taken, _ = waiting(cell)
        become(cell, versions[version])
        said = subprocess.run(
            [sys.executable, "-m", "rosplc", "--version"],
            env=bridge.environment, cwd="/", capture_output=True, text=True, check=True,
        )  # fmt: skip
        assert version in said.stdout
        cell.ensure()
        cell.await_flow(cell.marks())
        assert beside(bridge.pid).startswith(str(versions[version]))
        # Said a moment after messages flow.
        cell.wait(lambda: bridge.log.read_text().count("4 objects adopted") == swaps, "objects are adopted")  # noqa: B023
        account(cell, taken)
    assert generations(cell) == objects
    assert cell.parts["plc"].pid == plc and cell.parts["plc"].alive
    assert cell.counters.violations() == {"torn": 0, "invented": 0, "disordered": 0}
