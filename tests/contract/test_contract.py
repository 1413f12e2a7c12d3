"""What users of 0.1.0 rely on is still there, or the change log says that it is not."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from fnmatch import fnmatchcase
from pathlib import Path

import pytest

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib  # comes with pytest

HERE = Path(__file__).parent
ROOT = HERE.parents[1]
FROZEN: dict[str, str] = json.loads((HERE / "0.1.0.json").read_text("utf-8"))
INTENDED: dict[str, str] = tomllib.loads((HERE / "intended.toml").read_text("utf-8"))
LOOSER = {("required", "optional")}

pytestmark = pytest.mark.xdist_group("contract")  # one worker collects


@pytest.fixture(scope="module")
def changed() -> dict[str, tuple[str, str | None]]:
    """Give the items that are not as they were: as frozen, and now."""
    pytest.importorskip("cyclonedds")
    done = subprocess.run(
        [sys.executable, str(HERE / "collect.py")],
        env={**os.environ, "PYTHONPATH": str(ROOT / "src")}, capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    now: dict[str, str] = json.loads(done.stdout)
    return {
        item: (value, now.get(item))
        for item, value in FROZEN.items()
        if now.get(item) != value and (value, now.get(item)) not in LOOSER
    }


def test_what_changed_is_in_the_change_log(changed: dict[str, tuple[str, str | None]]) -> None:
    """A public name, option, key or code that went or changed has its line in CHANGELOG.md."""
    silent = {item: values for item, values in changed.items()
              if not any(fnmatchcase(item, pattern) for pattern in INTENDED)}  # fmt: skip
    assert not silent


def test_every_intended_difference_is_one(changed: dict[str, tuple[str, str | None]]) -> None:
    """Each entry of intended.toml matches something, and quotes the change log."""
    log = " ".join((ROOT / "CHANGELOG.md").read_text("utf-8").split())
    for pattern, quote in INTENDED.items():
        assert any(fnmatchcase(item, pattern) for item in changed), pattern
        assert quote in log, quote
