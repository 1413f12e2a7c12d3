"""Each of thirty faults, put into a copy of the product, turns tests of the first tier red."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib  # comes with pytest

ROOT = Path(__file__).resolve().parents[2]
FAULTS: dict[str, Any] = tomllib.loads(Path(__file__).with_name("faults.toml").read_text("utf-8"))
PARTS = ("src", "include", "spec", "tests", "tools", "examples", "docs", "packaging")
UNWANTED = shutil.ignore_patterns("__pycache__", "corpus", "peers", "*.o")
FIRST_TIER = "not verify and not foreign and not serial"
TESTS_FAILED = 1


def place_of(fault: dict[str, Any], root: Path) -> Path:
    """Return the one file that holds what the fault replaces."""
    folders = [root / "src", root / "include"]
    paths = [path for folder in folders for path in folder.rglob(fault["under"]) if path.is_file()]
    found = [path for path in paths if fault["find"] in path.read_text("utf-8")]
    assert len(found) == 1, f"{len(found)} files hold {fault['find']!r}"
    assert found[0].read_text("utf-8").count(fault["find"]) == 1
    return found[0]


@pytest.mark.parametrize("name", FAULTS)
def test_the_fault_has_its_place(name: str) -> None:
    """What a fault replaces is there, once; and its tests are."""
    place_of(FAULTS[name], ROOT)
    assert all((ROOT / path).exists() for path in FAULTS[name]["caught_by"])


def test_there_are_thirty() -> None:
    """In C, Python and Structured Text."""
    assert len(FAULTS) == 30
    assert {name.split("-")[0] for name in FAULTS} == {"c", "py", "st"}


@pytest.fixture(scope="module")
def copy(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """Give a copy of the repository, to be broken."""
    folder = tmp_path_factory.mktemp("faults") / "rosplc"
    folder.mkdir()
    for part in PARTS:
        if (ROOT / part).exists():
            shutil.copytree(ROOT / part, folder / part, ignore=UNWANTED)
    for path in ROOT.iterdir():
        if path.is_file():
            shutil.copy(path, folder)
    if (ROOT / ".cache").exists():
        (folder / ".cache").symlink_to(ROOT / ".cache")  # translated Structured Text, by its hash
    yield folder
    shutil.rmtree(folder)


@pytest.mark.verify(minutes=2)
@pytest.mark.timeout(1800)
@pytest.mark.parametrize("name", FAULTS)
def test_make_test_notices(name: str, copy: Path) -> None:
    """With the fault in place, tests of the first tier fail."""
    fault = FAULTS[name]
    place = place_of(fault, copy)
    sound = place.read_text("utf-8")
    environment = {**os.environ, "PYTHONPATH": str(copy / "src")}
    build = [sys.executable, "setup.py", "-q", "build_ext", "--inplace", "--force"]
    place.write_text(sound.replace(fault["find"], fault["replace"]), "utf-8")
    try:
        if place.suffix == ".h":
            subprocess.run(build, cwd=copy, check=True, capture_output=True)
        done = subprocess.run(
            [sys.executable, "-m", "pytest", "-q", "-x", "-p", "no:cacheprovider", "-m", FIRST_TIER,
             *fault["caught_by"]],
            cwd=copy, env=environment, capture_output=True, text=True, check=False,
        )  # fmt: skip
    finally:
        place.write_text(sound, "utf-8")
        if place.suffix == ".h":
            subprocess.run(build, cwd=copy, check=True, capture_output=True)
    assert done.returncode == TESTS_FAILED, done.stdout[-3000:] + done.stderr[-1000:]
