"""The fault campaign in a short form; ``make soak`` runs it for as long as one likes."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

pytestmark = pytest.mark.verifies("campaign", own="[the fault campaign](fault-campaign.md)")

ROOT = Path(__file__).resolve().parents[2]


def campaign(folder: Path, *options: str) -> dict[str, Any]:
    """Run a campaign; return what it found. Its order of faults is printed, and can be repeated."""
    report = folder / "report.json"
    done = subprocess.run(
        [sys.executable, "-m", "tests.soak", "--json", str(report), *options],
        cwd=ROOT,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        timeout=560,
    )
    print(done.stdout)
    if done.returncode == 2:
        pytest.skip(done.stdout.strip().splitlines()[-1])
    assert done.returncode == 0, done.stdout
    found: dict[str, Any] = json.loads(report.read_text())
    assert found["violations"] == []
    return found


@pytest.mark.foreign
def test_a_few_rounds(tmp_path: Path) -> None:
    """Kills, stops, removed objects and reloads leave nothing torn, invented, uncounted or behind."""
    words = ("kill -9 bridge", "stop bridge", "reloaded", "refused", "all files", "full", "flood")
    faults = [option for word in words for option in ("--fault", word)]
    found = campaign(tmp_path, "--seed", "5", "--rounds", "4", "--minutes", "0.1", *faults)
    assert found["rounds"] >= 1
    assert found["messages"] > 100


@pytest.mark.verify(minutes=1.5)
@pytest.mark.needs("faketime")
@pytest.mark.timeout(600)
def test_all_faults(tmp_path: Path) -> None:
    """All kinds of fault in an order of their own: each is survived."""
    found = campaign(tmp_path, "--minutes", "1.2")
    assert found["rounds"] >= 1


@pytest.mark.verify(minutes=0.5)
@pytest.mark.timeout(600)
@pytest.mark.parametrize(
    "backend", ["zenoh", pytest.param("rospy", marks=pytest.mark.needs("python3-rospy"))]
)
def test_with_a_router_or_a_master(tmp_path: Path, backend: str) -> None:
    """Where there is a router or a master, its death is one of the faults."""
    words = ("hub", "kill -9 bridge", "stop", "removed", "reloaded")
    faults = [option for word in words for option in ("--fault", word)]
    found = campaign(tmp_path, "--backend", backend, "--minutes", "0.3", *faults)
    assert found["messages"] > 100


@pytest.mark.verify(minutes=0.5)
@pytest.mark.timeout(600)
def test_with_structured_text_and_classic_topics(tmp_path: Path) -> None:
    """With generated Structured Text, executed, death inside a classic topic's lock is one of the faults."""
    words = ("lock", "kill -9 plc", "online change", "removed")
    faults = [option for word in words for option in ("--fault", word)]
    found = campaign(tmp_path, "--plc", "st", "--minutes", "0.4", *faults)
    assert found["messages"] > 100
