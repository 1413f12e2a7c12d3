"""This bridge takes the place of the last release's, and back, while PLC and ROS nodes go on."""

from __future__ import annotations

import signal
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from deploy.wheel import PIP, build_wheel, project_version, run
from rosplc.shm import attach
from tests.peers.release import OLD, old_release
from tests.soak.cell import Cell
from tests.soak.messages import OUT, TOPICS

pytestmark = pytest.mark.verifies("upgrade", own="wheels of two releases")

WATCHDOG_S = 120.0


@pytest.fixture(scope="module")
def versions(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """Give the last release and this checkout, each installed from its wheel into a folder of its own."""
    folder = tmp_path_factory.mktemp("versions")
    sources = {OLD: old_release().parent, project_version(): build_wheel(folder / "wheel")}
    for version, source in sources.items():
        # What they stand on is this environment's.
        options = ["--quiet", "--no-deps", "--no-build-isolation", "--target", folder / version]
        run([*PIP, "install", *options, source])
    return {version: folder / version for version in sources}


@pytest.fixture(params=["python", "st"])
def cell(request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[Cell]:
    pytest.importorskip("cyclonedds")
    if request.param == "st":
        pytest.importorskip("blark")
    cell = Cell(tmp_path, "dds", private=False, plc=request.param)
    cell.slots_key = "depth"
    yield cell
    cell.close()


def become(cell: Cell, place: Path, *arguments: str) -> str:
    """Let the cell's bridge be the version in a folder, from its next start on; return what it prints."""
    environment = cell.parts["bridge"].environment
    environment["PYTHONPATH"] = str(place)
    return run([sys.executable, "-m", "rosplc", *arguments], cwd=Path("/"), environment=environment)


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
    """0.1.0, today's, 0.1.0: objects stay, the PLC goes on, nothing is torn or invented, losses counted."""
    become(cell, versions[OLD], "version")
    cell.start()
    objects, plc = generations(cell), cell.parts["plc"].pid
    bridge = cell.parts["bridge"]
    before = cell.config.read_text()
    for swaps, version in enumerate((project_version(), OLD), 1):
        assert bridge.terminate(WATCHDOG_S) and bridge.status == 0
        taken, _ = waiting(cell)
        assert version in become(cell, versions[version], "--version")
        if version == OLD:
            cell.config.write_text(before)  # which knows the former keys alone
        else:
            become(cell, versions[version], "check", "--fix", str(cell.config))
            assert "slots: 64" in cell.config.read_text()
        cell.ensure()
        cell.await_flow(cell.marks())
        assert beside(bridge.pid).startswith(str(versions[version]))
        # Said a moment after messages flow.
        cell.wait(lambda: bridge.log.read_text().count("4 objects adopted") == swaps, "objects are adopted")  # noqa: B023
        account(cell, taken)
    assert generations(cell) == objects
    assert cell.parts["plc"].pid == plc and cell.parts["plc"].alive
    assert cell.counters.violations() == {"torn": 0, "invented": 0, "disordered": 0}
