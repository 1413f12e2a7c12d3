"""A run's folder in shared memory goes with it, and what a killed run has left goes with the next."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

from rosplc_bench.run import NAMES_FILE, PREFIX, scratch_folder, sweep

_HOLDS_ONE = """
import sys
from pathlib import Path
from rosplc_bench.run import scratch_folder
with scratch_folder(Path(sys.argv[1])) as folder:
    (folder / "something").write_text("x")
    print(folder, flush=True)
    sys.stdin.read()
"""


def _run(memory: Path) -> tuple[subprocess.Popen[str], Path]:
    process = subprocess.Popen(
        [sys.executable, "-c", _HOLDS_ONE, str(memory)],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
    )
    assert process.stdout is not None
    return process, Path(process.stdout.readline().strip())


def test_a_run_leaves_nothing(tmp_path: Path) -> None:
    """Folder, semaphores and files with a noted name are gone; others' stay."""
    with scratch_folder(tmp_path) as folder:
        pair = folder / "pair"
        pair.mkdir()
        (pair / NAMES_FILE).write_text("rb01234567_")
        for name in (f"sem.{folder.name}.pair.a", "rb01234567_node", "rb76543210_node", "other"):
            (tmp_path / name).write_text("")
    assert sorted(path.name for path in tmp_path.iterdir()) == ["other", "rb76543210_node"]


def test_names_that_nobody_gave_remove_nothing(tmp_path: Path) -> None:
    """A file of names that was damaged does not take foreign files along."""
    with scratch_folder(tmp_path) as folder:
        for number, text in enumerate(("", "o", "rb", "rb01234567_\nother")):
            (folder / str(number)).mkdir()
            (folder / str(number) / NAMES_FILE).write_text(text)
        (tmp_path / "other").write_text("")
    assert [path.name for path in tmp_path.iterdir()] == ["other"]


def test_a_killed_run_is_cleared_away_and_a_living_one_is_not(tmp_path: Path) -> None:
    """What a run leaves that was killed is removed by the next; who still runs keeps everything."""
    dead, left = _run(tmp_path)
    dead.kill()
    dead.communicate()
    assert left.is_dir()
    living, kept = _run(tmp_path)  # clears away before it makes its own
    try:
        assert not left.exists()
        assert sweep(tmp_path) == [] and (kept / "something").is_file()
    finally:
        living.communicate("")
    assert list(tmp_path.iterdir()) == []


def test_a_folder_without_a_lock_is_young_or_left_over(tmp_path: Path) -> None:
    """A folder that is being made is not removed; an old one is, and so is nothing but folders."""
    young, old, file = (tmp_path / f"{PREFIX}{name}" for name in ("young", "old", "file"))
    young.mkdir()
    old.mkdir()
    file.write_text("")
    os.utime(old, (1, 1))
    assert sweep(tmp_path) == [old]
    assert young.is_dir() and file.is_file()
