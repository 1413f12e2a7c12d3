"""A 32-bit ARM Debian in an emulator: rosplc is installed there, carries messages, and becomes a package."""

from __future__ import annotations

import shutil
import subprocess
from collections.abc import Iterator
from pathlib import Path

import pytest

from deploy.board import ARCHITECTURES, Board
from deploy.deb import pack_board
from deploy.measure import ENVIRONMENT, guest_memory
from deploy.wheel import DeployError, project_version, run
from tests.soak.cell import Cell
from tests.soak.processes import Part

pytestmark = pytest.mark.verifies("arm-board", real="Debian armhf in an emulator")

ARM = (1, 40)
"""Word size and processor that a program's file states (ELF, EI_CLASS and e_machine)."""
BOARD_KIB = 512 * 1024


@pytest.fixture(scope="module")
def board(tmp_path_factory: pytest.TempPathFactory) -> Board:
    folder = tmp_path_factory.mktemp("board")
    try:
        board = Board(folder / "root", ARCHITECTURES["armhf"])
    except DeployError as error:
        pytest.skip(str(error))
    board.make()
    board.install(folder / "wheels")
    return board


@pytest.fixture
def cell(tmp_path: Path, board: Board) -> Iterator[Cell]:
    """Give a cell on Zenoh whose bridge runs on the board; PLC, peers and router are this machine's."""
    pytest.importorskip("zenoh")
    cell = Cell(tmp_path, "zenoh", private=False)

    def command() -> list[str]:
        shutil.copy(cell.config, board.root / "tmp/cell.yaml")
        return board.python("-m", "rosplc", "run", "/tmp/cell.yaml", "--status", "0")

    environment = {**board.environment, **ENVIRONMENT}
    cell.parts["bridge"] = Part("bridge", command, environment, cell.parts["bridge"].log)
    yield cell
    cell.close()


def kind(path: Path) -> tuple[int, int]:
    head = path.read_bytes()[:20]
    assert head[:4] == b"\x7fELF", path
    return head[4], head[18] | head[19] << 8


@pytest.mark.verify(minutes=3)
@pytest.mark.timeout(1800)
def test_a_bridge_on_a_board(cell: Cell, board: Board) -> None:
    """Its messages reach a 64-bit PLC and back, also after a kill, and it leaves most of 512 MB to others."""
    cell.start()
    cell.parts["bridge"].kill()
    cell.ensure()
    cell.await_flow(cell.marks())
    assert cell.counters.violations() == {"torn": 0, "invented": 0, "disordered": 0}
    memory = guest_memory(cell.parts["bridge"].pid)
    assert memory.own > 0 and memory.files > 0
    assert memory.total < BOARD_KIB / 2
    assert kind(next((board.root / "opt/rosplc/lib").rglob("_native.abi3.so"))) == ARM


@pytest.mark.verify(minutes=1)
@pytest.mark.timeout(1800)
def test_a_package_for_a_board(board: Board, tmp_path: Path) -> None:
    """The package holds nothing of this machine's kind, names what Debian has to bring, and runs unpacked."""
    package = pack_board(board, tmp_path / "stage", tmp_path, project_version())
    control = run(["dpkg-deb", "--field", package])
    assert "Architecture: armhf" in control
    for name in board.architecture.debian:
        assert name in control
    for path in (tmp_path / "stage").rglob("*.so"):
        assert kind(path) == ARM, path
    shutil.rmtree(board.root / "opt/rosplc")
    subprocess.run(["dpkg-deb", "--extract", package, board.root], check=True)
    home = "/opt/rosplc/bin"
    said = run(
        board.command("/usr/bin/python3", f"{home}/rosplc", "--version", argv0=f"{home}/python3"),
        environment=board.environment,
    )
    assert project_version() in said
