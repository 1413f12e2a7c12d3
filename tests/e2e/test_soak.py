"""The fault campaign in a short form; ``make soak`` runs it for as long as one likes."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

ROOT = Path(__file__).resolve().parents[2]


def campaign(folder: Path, *options: str) -> dict[str, Any]:
    """Run a campaign; return what it found. Its order of faults is printed, and can be repeated."""
    report = folder / "report.json"
    done = subprocess.run(
        [sys.executable, "-m", "soak", "--json", str(report), *options],
        cwd=ROOT,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        timeout=400,
    )
    print(done.stdout)
    if done.returncode == 2:
        pytest.skip(done.stdout.strip().splitlines()[-1])
    assert done.returncode == 0, done.stdout
    found: dict[str, Any] = json.loads(report.read_text())
    assert found["violations"] == []
    return found


def test_a_few_rounds(tmp_path: Path) -> None:
    """Kills, stops, removed objects and reloads leave nothing torn, invented, uncounted or behind."""
    words = ("kill -9 bridge", "stop bridge", "reloaded", "refused", "all files", "full", "flood")
    faults = [option for word in words for option in ("--fault", word)]
    found = campaign(tmp_path, "--seed", "5", "--rounds", "9", "--minutes", "0.3", *faults)
    assert found["rounds"] >= 1
    assert found["messages"] > 100


@pytest.mark.verify(minutes=4)
@pytest.mark.serial
@pytest.mark.timeout(420)
def test_minutes_of_all_faults(tmp_path: Path) -> None:
    """All kinds of fault in an order of their own, for minutes: each is survived."""
    found = campaign(tmp_path, "--minutes", "3")
    if "clock steps" in found["skipped"] and "faketime" in found["skipped"]["clock steps"]:
        pytest.skip("Debian package faketime is missing")
    assert len(found["faults"]) >= 15


@pytest.mark.verify(minutes=2)
@pytest.mark.parametrize("backend", ["zenoh", "rospy"])
def test_with_a_router_or_a_master(tmp_path: Path, backend: str) -> None:
    """Where there is a router or a master, its death is one of the faults."""
    if backend == "rospy" and not Path("/usr/lib/python3/dist-packages/rospy/__init__.py").exists():
        pytest.skip("Debian package python3-rospy is missing")
    words = ("hub", "kill -9 bridge", "stop", "removed", "reloaded")
    faults = [option for word in words for option in ("--fault", word)]
    found = campaign(tmp_path, "--backend", backend, "--minutes", "0.8", *faults)
    assert found["messages"] > 100
