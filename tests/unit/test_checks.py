"""The checks' own reports: what was not run is named, and never taken for a pass."""

from __future__ import annotations

import importlib.util
import json
import os
import subprocess
import sys
import time
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest

ROOT = Path(__file__).resolve().parents[2]
TESTS = """
import pytest

def test_passes(): pass
@pytest.mark.needs("some-tool")
def test_lacks_a_package(): pass
@pytest.mark.needs(variable="ROSPLC_SOME_TOOL")
def test_lacks_a_variable(): pass
@pytest.mark.needs(when=False, why="no such processor")
def test_lacks_something(): pass
def test_other_skip(): pytest.skip("no reason")
@pytest.mark.foreign
def test_foreign(): pass

@pytest.mark.verify(minutes=30)
def test_long(): pass

@pytest.mark.verify
def test_short(): pass
"""
INI = "[pytest]\nmarkers =\n    verify: long\n    needs: what it needs\n    foreign: foreign\n"
WORKERS = [
    pytest.param((), id="one process", marks=pytest.mark.foreign),
    pytest.param(("-n", "2"), id="xdist"),
]
ABSENT = {
    "test_lacks_a_package": "Debian package some-tool is missing",
    "test_lacks_a_variable": "ROSPLC_SOME_TOOL is not set",
    "test_lacks_something": "no such processor",
}


def run(folder: Path, *options: str, **env: str) -> tuple[int, str, Any]:
    """Run the sample tests under the repository's conftest; return status, output and report."""
    (folder / "conftest.py").write_text((ROOT / "conftest.py").read_text(encoding="utf-8"), encoding="utf-8")
    (folder / "pytest.ini").write_text(INI, encoding="utf-8")
    report = folder / "report.json"
    clean = {
        key: value for key, value in os.environ.items() if not key.startswith(("CI", "ROSPLC", "PYTEST"))
    }
    done = subprocess.run(
        [sys.executable, "-m", "pytest", "-rA", "-p", "no:cacheprovider", "-p", "xdist", *options],
        cwd=folder,
        env={**clean, "PYTEST_DISABLE_PLUGIN_AUTOLOAD": "1", "ROSPLC_REPORT": str(report), **env},
        stdin=subprocess.DEVNULL,
        capture_output=True,
        text=True,
        check=False,
    )
    found = json.loads(report.read_text())
    for name in ("absent", "skipped"):
        found[name] = {key.split("::")[-1]: reason for key, reason in found[name].items()}
    return done.returncode, done.stdout, found


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    (tmp_path / "test_sample.py").write_text(TESTS, encoding="utf-8")
    return tmp_path


@pytest.mark.parametrize("workers", WORKERS)
def test_what_a_machine_lacks_is_listed_and_not_skipped(folder: Path, workers: tuple[str, ...]) -> None:
    """On a laptop a check whose need is not met is deselected, and listed with the need."""
    status, output, reported = run(folder, *workers)
    assert status == 0, output
    assert reported["absent"] == ABSENT
    assert reported["skipped"] == {"test_other_skip": "no reason"}
    assert output.count("NOT HERE ") == 3
    assert "4 passed, 1 skipped" in output


@pytest.mark.parametrize("workers", WORKERS)
def test_missing_package_fails_in_ci(folder: Path, workers: tuple[str, ...]) -> None:
    """In CI a missing package is a failure; what no registry has is still only listed."""
    status, output, reported = run(folder, *workers, CI="true")
    assert status == 1
    assert "4 passed, 1 skipped" in output and "1 error" in output
    assert set(reported["absent"]) == set(ABSENT) - {"test_lacks_a_package"}


@pytest.mark.parametrize("workers", WORKERS)
def test_a_test_that_has_to_be_repeated_is_reported(folder: Path, workers: tuple[str, ...]) -> None:
    """One that fails twice is a failure; one that fails once passes, and is named."""
    (folder / "test_sample.py").write_text(
        "from pathlib import Path\n"
        "def test_never(): raise OSError('always')\n"
        "def test_second_time():\n"
        "    seen = Path(__file__).with_suffix('.seen')\n"
        "    if not seen.exists():\n        seen.touch()\n        raise OSError('once')\n",
        encoding="utf-8",
    )
    again = ("-p", "pytest_rerunfailures", "--reruns", "1", "--rerun-show-tracebacks")
    status, output, reported = run(folder, *workers, *again)
    assert status == 1 and "1 failed, 1 passed, 2 rerun" in output
    assert [name.partition("::")[2] for name in sorted(reported["repeated"])] == [
        "test_never",
        "test_second_time",
    ]
    assert "OSError: once" in output


def test_what_needs_a_package_or_a_variable_is_foreign(folder: Path) -> None:
    """Such checks are no part of the first tier, and need no second marker for it."""
    status, output, reported = run(folder, "-m", "foreign")
    assert status == 0, output
    assert "1 passed" in output
    assert set(reported["absent"]) == {"test_lacks_a_package", "test_lacks_a_variable"}


def test_module_that_lacks_a_package_fails_in_ci(folder: Path) -> None:
    """A skip of a whole module is no way around the rule."""
    (folder / "test_sample.py").write_text(
        "import pytest\npytest.skip('Debian package some-tool is missing', allow_module_level=True)\n",
        encoding="utf-8",
    )
    status, _, reported = run(folder)
    assert status == 5  # no tests, no failure
    assert list(reported["absent"].values()) == ["Debian package some-tool is missing"]
    status, output, _ = run(folder, CI="true")
    assert status not in (0, 5), output


@pytest.mark.parametrize(
    ("left", "reached", "workers"), [(0.0, 0, ()), (600.0, 1, ()), (600.0, 1, ("-n", "2")), (3600.0, 2, ())]
)
def test_what_does_not_fit_into_the_time_is_not_reached(
    folder: Path, left: float, reached: int, workers: tuple[str, ...]
) -> None:
    """A long check starts only if its minutes fit; otherwise it is neither passed nor failed."""
    deadline = str(time.time() + left)
    _, output, reported = run(folder, *workers, "-m", "verify", ROSPLC_DEADLINE=deadline)
    assert len(reported["unreached"]) == 2 - reached, output
    assert output.count("PASSED test_") == reached


def checks() -> ModuleType:
    """Import tools/checks.py, which is a program and no package."""
    spec = importlib.util.spec_from_file_location("rosplc_checks", ROOT / "tools" / "checks.py")
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module
    spec.loader.exec_module(module)
    return module


def test_summary_names_packages_and_unreached_checks(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """The end of a run names what was not run, with the command that installs what is missing."""
    monkeypatch.delenv("ROSPLC_SUMMARY", raising=False)
    module = checks()
    outcome = module.Outcome(steps=[("tests", True, 1.0)], summaries=["==== 3 passed in 1.00s ===="])
    outcome.absent = {
        "a": "Debian package one is missing",
        "d[1]": "ONE is not set",
        "d[2]": "ONE is not set",
    }
    outcome.skipped = {"c": "why not"}
    outcome.unreached = ["b"]
    outcome.repeated = ["e[x]", "e[y]"]
    module.report(outcome)
    text = capsys.readouterr().out
    assert "ONE is not set\n      d (2 cases)\n" in text
    assert "sudo apt-get install one" in text
    assert "Not run for lack of time: 1 checks\n      b\n" in text
    assert "Skipped:\n   c: why not\n" in text
    assert "UNRELIABLE, failed and was repeated:\n      e (2 cases)\n" in text
    assert text.splitlines()[-1] == "==== 3 passed in 1.00s ===="


@pytest.mark.parametrize(
    "line",
    [
        "===== 3 passed in 1.00s =====",
        "== 1 failed, 2 passed, 3 skipped in 100.12s (0:01:40) ==",
        "3 passed, 1 warning in 0.50s",
        "==== 5 deselected in 0.10s ====",
        "= no tests ran in 0.01s =",
    ],
)
def test_summary_line_of_pytest_is_recognised(line: str) -> None:
    """Whatever pytest ends with is found among its output."""
    assert checks().SUMMARY.match(line)
