"""predict.h alone, stepped through histories; no time in here is real."""

from __future__ import annotations

import subprocess
from pathlib import Path

import pytest

_SOURCE = Path(__file__).with_name("predict_test.c")
_CORE = Path(__file__).resolve().parents[3] / "src/rosplc/_core"
_WARNINGS = ["-std=gnu11", "-O1", "-g", "-Wall", "-Wextra", "-Wconversion", "-Wshadow", "-Werror"]
_SANITIZE = ["-fsanitize=address,undefined", "-fno-sanitize-recover=all"]
_TICKS = 10_000  # of a history


@pytest.fixture(scope="module")
def program(tmp_path_factory: pytest.TempPathFactory) -> str:
    made = str(tmp_path_factory.mktemp("predict") / "predict_test")
    command = ["gcc", *_WARNINGS, *_SANITIZE, f"-I{_CORE}", str(_SOURCE), "-o", made]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return made


def _run(program: str, *arguments: object) -> dict[str, int]:
    done = subprocess.run([program, *map(str, arguments)], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    words = done.stdout.split()
    return {name: int(value) for name, value in zip(words[::2], words[1::2], strict=True)}


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize(
    "tasks",
    [
        pytest.param(("steady", 10_000, 1), id="100 Hz"),
        pytest.param(("steady", 1_000, 5), id="a period of one tick"),
        pytest.param(("steady", 4_000, 5, "steady", 9_798, 5), id="incommensurate"),
        pytest.param(("steady", 20_000, 5, "steady", 2_000, 3, "steady", 50_000, 3), id="multiples"),
    ],
)
def test_steady_tasks_are_met(program: str, tasks: tuple[object, ...], seed: int) -> None:
    """Looks meet tasks with jitter shortly after they publish, with few looks beyond one per tick."""
    found = _run(program, "history", seed, 50, 0, *tasks)
    assert found["median"] <= 100
    assert found["p99"] <= 300
    assert found["looks"] <= 1.13 * _TICKS


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize(
    "tasks",
    [
        pytest.param(("irregular", 7_300, 4), id="irregular"),
        pytest.param(("steady", 250, 4), id="faster than the tick"),
        pytest.param(("steady", 1_500, 4, "steady", 1_100, 4), id="more often than looks are allowed"),
    ],
)
def test_what_cannot_be_met_costs_ticks(program: str, tasks: tuple[object, ...], seed: int) -> None:
    """Where nothing can be predicted, or only with too many looks, news waits for a tick, as without it."""
    found = _run(program, "history", seed, 50, 0, *tasks)
    assert found["p99"] <= 1_250
    assert found["looks"] <= 1.05 * _TICKS


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize(
    ("tasks", "share"),
    [
        pytest.param(("steady", 10_000, 5), 0.4, id="one task"),
        pytest.param(("steady", 10_000, 5, "steady", 14_142, 5), 0.5, id="two tasks"),
        pytest.param((), 0.3, id="nothing"),
    ],
)
def test_looks_wait_for_steady_tasks(
    program: str, tasks: tuple[object, ...], share: float, seed: int
) -> None:
    """While tasks explain all that changes, looks are for their sake alone, and still meet them."""
    found = _run(program, "history", seed, 50, 10_000, *tasks)
    assert found["p99"] <= 300
    assert found["looks"] <= share * _TICKS


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize(
    "tasks",
    [
        pytest.param(("irregular", 7_300, 4), id="alone"),
        pytest.param(("irregular", 7_300, 4, "steady", 10_000, 5), id="beside a steady task"),
        pytest.param(("steady", 250, 4), id="faster than the tick"),
    ],
)
def test_looks_wait_for_nothing_else(program: str, tasks: tuple[object, ...], seed: int) -> None:
    """What no task explains is met at the next tick, even where looks may wait longer."""
    assert _run(program, "history", seed, 50, 10_000, *tasks)["p99"] <= 1_250


@pytest.mark.parametrize("seed", range(4))
def test_any_history_is_survived(program: str, seed: int) -> None:
    """Heads, times and ticks at random neither overflow nor lead astray."""
    _run(program, "scribble", seed)
