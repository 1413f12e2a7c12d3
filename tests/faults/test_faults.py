"""Each of thirty-four faults, put into a copy of the product, turns the tests red that are named with it."""

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
PARTS = ("src", "spec", "tests", "tools", "examples", "docs", "packaging", "benchmarks")
UNWANTED = shutil.ignore_patterns("__pycache__", "corpus", "peers", "images", "*.o")
FIRST_TIER = "not verify and not foreign"
TESTS_FAILED = 1


def place_of(fault: dict[str, Any], root: Path) -> Path:
    """Return the one file that holds what the fault replaces."""
    paths = [path for path in (root / "src").rglob(fault["under"]) if path.is_file()]
    found = [path for path in paths if fault["find"] in path.read_text("utf-8")]
    assert len(found) == 1, f"{len(found)} files hold {fault['find']!r}"
    assert found[0].read_text("utf-8").count(fault["find"]) == 1
    return found[0]


@pytest.mark.parametrize("name", FAULTS)
def test_the_fault_has_its_place(name: str) -> None:
    """What a fault replaces is there, once; and so are the tests that notice it."""
    place_of(FAULTS[name], ROOT)
    for test in FAULTS[name]["caught_by"]:
        path, _, function = test.partition("::")
        assert f"def {function}(" in (ROOT / path).read_text("utf-8"), test


def test_there_are_thirty_four() -> None:
    """In C, Python and Structured Text."""
    assert len(FAULTS) == 34
    assert {name.split("-")[0] for name in FAULTS} == {"c", "py", "st"}


@pytest.fixture(scope="module")
def copy(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """Give a copy of the repository, to be broken."""
    folder = tmp_path_factory.mktemp("faults") / "rosplc"
    folder.mkdir()
    for part in PARTS:
        shutil.copytree(ROOT / part, folder / part, ignore=UNWANTED)
    for path in ROOT.iterdir():
        if path.is_file():
            shutil.copy(path, folder)
    yield folder
    shutil.rmtree(folder)


@pytest.mark.verify(minutes=0.3)
@pytest.mark.timeout(1800)
@pytest.mark.parametrize("name", FAULTS)
def test_the_first_tier_notices(name: str, copy: Path) -> None:
    """With the fault in place, the tests named with it fail; they belong to the first tier."""
    fault = FAULTS[name]
    place = place_of(fault, copy)
    saved = {path: path.read_bytes() for path in (place, *copy.glob("src/rosplc/_core/*.so"))}
    environment = {**os.environ, "PYTHONPATH": str(copy / "src")}
    place.write_text(place.read_text("utf-8").replace(fault["find"], fault["replace"]), "utf-8")
    try:
        if place.suffix == ".h":
            build = [sys.executable, "setup.py", "-q", "build_ext", "--inplace", "--force"]
            subprocess.run(build, cwd=copy, check=True, capture_output=True)
        options = ["-q", "-x", "-p", "no:cacheprovider", "-m", FIRST_TIER]
        done = subprocess.run(
            [sys.executable, "-m", "pytest", *options, *fault["caught_by"]],
            cwd=copy, env=environment, capture_output=True, text=True, check=False,
        )  # fmt: skip
    finally:
        for path, content in saved.items():
            path.write_bytes(content)
    assert done.returncode == TESTS_FAILED, done.stdout[-3000:] + done.stderr[-1000:]
    assert "\nERROR " not in done.stdout, done.stdout[-3000:]  # a test has failed, and not its set-up
