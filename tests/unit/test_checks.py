"""The checks' own reports: what was not run is named, and never taken for a pass."""

from __future__ import annotations

import importlib.util
import json
import os
import subprocess
import sys
from pathlib import Path
from types import ModuleType

import pytest

ROOT = Path(__file__).resolve().parents[2]
TESTS = """
import pytest

def test_passes(): pass
def test_lacks_a_package(): pytest.skip("Debian package some-tool is missing")
def test_other_skip(): pytest.skip("no reason")

@pytest.mark.verify(minutes=30)
def test_long(): pass

@pytest.mark.verify
def test_short(): pass
"""
INI = "[pytest]\nmarkers =\n    verify: long\n"


def run(folder: Path, *options: str, **env: str) -> tuple[int, str, dict[str, str]]:
    """Run the sample tests under the repository's conftest; return status, output and report."""
    (folder / "conftest.py").write_text((ROOT / "conftest.py").read_text(encoding="utf-8"), encoding="utf-8")
    (folder / "pytest.ini").write_text(INI, encoding="utf-8")
    report = folder / "report.json"
    clean = {
        key: value for key, value in os.environ.items() if not key.startswith(("CI", "ROSPLC", "PYTEST"))
    }
    done = subprocess.run(
        [sys.executable, "-m", "pytest", "-rA", "-p", "no:cacheprovider", *options],
        cwd=folder,
        env={**clean, "ROSPLC_REPORT": str(report), **env},
        stdin=subprocess.DEVNULL,
        capture_output=True,
        text=True,
        check=False,
    )
    reported = {key.split("::")[-1]: reason for key, reason in json.loads(report.read_text()).items()}
    return done.returncode, done.stdout, reported


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    (tmp_path / "test_sample.py").write_text(TESTS, encoding="utf-8")
    return tmp_path


@pytest.mark.parametrize("workers", [(), ("-n", "2")], ids=["one process", "xdist"])
def test_skips_are_reported_with_their_reasons(folder: Path, workers: tuple[str, ...]) -> None:
    """On a laptop a missing package is a skip, and the report names it."""
    status, output, reported = run(folder, *workers)
    assert status == 0, output
    assert reported == {
        "test_lacks_a_package": "Debian package some-tool is missing",
        "test_other_skip": "no reason",
    }


@pytest.mark.parametrize("workers", [(), ("-n", "2")], ids=["one process", "xdist"])
def test_missing_package_fails_in_ci(folder: Path, workers: tuple[str, ...]) -> None:
    """In CI the same skip is a failure; other skips stay skips."""
    status, output, reported = run(folder, *workers, CI="true")
    assert status == 1
    assert "1 failed, 3 passed, 1 skipped" in output
    assert set(reported) == {"test_other_skip"}


def test_module_that_lacks_a_package_fails_in_ci(folder: Path) -> None:
    """A skip of a whole module is no way around the rule."""
    (folder / "test_sample.py").write_text(
        "import pytest\npytest.skip('Debian package some-tool is missing', allow_module_level=True)\n",
        encoding="utf-8",
    )
    status, _, reported = run(folder)
    assert status == 5  # no tests, no failure
    assert list(reported.values()) == ["Debian package some-tool is missing"]
    status, output, _ = run(folder, CI="true")
    assert status not in (0, 5), output


@pytest.mark.parametrize(("left", "reached"), [(0.0, 0), (600.0, 1), (3600.0, 2)])
def test_what_does_not_fit_into_the_time_is_not_reached(folder: Path, left: float, reached: int) -> None:
    """A long check starts only if its minutes fit; otherwise it is neither passed nor failed."""
    import time

    status, output, reported = run(folder, "-m", "verify", ROSPLC_DEADLINE=str(time.time() + left))
    assert status == 0, output
    unreached = [reason for reason in reported.values() if reason.startswith("not reached")]
    assert len(unreached) == 2 - reached
    assert output.count("PASSED") == reached


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
    outcome.skipped = {"a": "Debian package one is missing", "b": module.NOT_REACHED, "c": "why not"}
    module.report(outcome)
    text = capsys.readouterr().out
    assert "one: 1 checks" in text
    assert "sudo apt-get install one" in text
    assert "neither passed nor failed: 1 checks\n   b\n" in text
    assert "1 × why not" in text
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
