"""Both distributions work from their wheels alone."""

from __future__ import annotations

import json
import os
import re
import shutil
import subprocess
import sys
import zipfile
from pathlib import Path

import pytest

import rosplc
from deploy.wheel import build_wheel

BENCHMARKS = Path(__file__).resolve().parents[3] / "benchmarks"
PIP = (sys.executable, "-m", "pip", "--disable-pip-version-check", "--quiet")


def run(*command: str, **variables: str) -> str:
    environment = {**os.environ, **variables}
    done = subprocess.run(command, cwd="/", env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 0, f"{' '.join(command)}\n{done.stdout}{done.stderr}"
    return done.stdout


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Build rosplc-bench from a copy that has nothing but its sources."""
    pytest.importorskip("setuptools", minversion="77")
    folder = tmp_path_factory.mktemp("rosplc-bench")
    unwanted = shutil.ignore_patterns("__pycache__")
    shutil.copytree(BENCHMARKS / "rosplc_bench", folder / "source/rosplc_bench", ignore=unwanted)
    shutil.copy(BENCHMARKS / "pyproject.toml", folder / "source")
    run(
        *PIP, "wheel", "--no-deps", "--no-build-isolation", "--wheel-dir", str(folder), str(folder / "source")
    )
    (made,) = folder.glob("rosplc_bench-*.whl")
    return made


def test_the_wheel_holds_every_file_and_follows_the_version(wheel: Path) -> None:
    """Modules and C sources are in it, the version is rosplc's, and so is the one that it needs."""
    archive = zipfile.ZipFile(wheel)
    expected = {
        str(path.relative_to(BENCHMARKS))
        for path in (BENCHMARKS / "rosplc_bench").rglob("*")
        if path.suffix in (".py", ".c", ".h", ".md")
    }
    assert expected == {name for name in archive.namelist() if ".dist-info/" not in name}
    (name,) = (name for name in archive.namelist() if name.endswith("METADATA"))
    metadata = archive.read(name).decode()
    assert f"\nVersion: {rosplc.__version__}\n" in metadata
    assert f"\nRequires-Dist: rosplc=={rosplc.__version__}\n" in metadata


@pytest.mark.foreign
def test_both_wheels_compare_without_the_sources(wheel: Path, tmp_path: Path) -> None:
    """Installed from wheels, the command measures, writes its report and its pictures, and shows it again."""
    pytest.importorskip("matplotlib")
    target, out = tmp_path / "site", tmp_path / "out"
    wheels = (str(build_wheel(tmp_path / "wheel")), str(wheel))
    run(*PIP, "install", "--no-deps", "--target", str(target), *wheels)
    assert re.search(r"Provides-Extra: bench", next(target.glob("rosplc-*.dist-info/METADATA")).read_text())
    here = {"PYTHONPATH": str(target)}
    where = "import rosplc, rosplc_bench; print(rosplc.__file__, rosplc_bench.__file__)"
    assert all(each.startswith(str(target)) for each in run(sys.executable, "-c", where, **here).split())
    command = (sys.executable, str(target / "bin/rosplc-bench"))
    options = ("--quick", "--section", "experiment", "--only", "rosplc-python", "--out", str(out), "--json")
    report = json.loads(run(*command, *options, **here))
    assert report["sections"][0]["data"]["arrangements"] and not report["sections"][0]["failures"]
    assert {"report.md", "report.json", "rate-one-core.png", "rate-one-core.svg"} <= set(os.listdir(out))
    assert "rosplc channel, Python" in run(*command, "--from", str(out / "report.json"), **here)
