"""Which tests a run has, and what it reports besides passes: checks that it could not run, or not in time.

Three tiers (tests/README.md), told apart by markers: ``make test`` has neither ``foreign`` nor ``verify``,
``make test-foreign`` has ``foreign``, ``make verify-long`` has ``verify``.

* ``needs("chromium")`` names Debian packages, ``needs(variable="ROSPLC_GENMC")`` a variable that names an
  installation, ``needs(when=…, why="…")`` anything else. A check whose need is not met is deselected and
  listed at the end, never skipped. In CI, which can install packages, a missing one is a failure.
* What needs a package or a variable, is ``serial``, or lies in a folder of ``FOREIGN``, is ``foreign``.
* A test that failed and passed when it was repeated (CI asks for that with ``ROSPLC_RERUNS``) is listed.
* ``ROSPLC_DEADLINE`` (seconds since 1970) ends a run: a check that no longer fits is not started, and listed.

``tools/checks.py`` reads the lists (a JSON file named by ``ROSPLC_REPORT``) and closes with them.
"""

from __future__ import annotations

import functools
import importlib.util
import json
import os
import signal
import subprocess
import time
from pathlib import Path
from typing import Any

import pytest

ROOT = Path(__file__).resolve().parent
if importlib.util.find_spec("rclpy"):  # a real one: its traffic stays on this machine
    os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"
FOREIGN = ("tests/deploy", "tests/interop", "tests/unit/bench", "tests/unit/benchmarks")
MISSING_PACKAGE = "Debian package "
DEFAULT_MINUTES = 2.0


# A shell starts background jobs with these ignored, and so would be every program that a test starts.
for number, handler in (
    (signal.SIGINT, signal.default_int_handler),
    (signal.SIGQUIT, signal.SIG_DFL),
    (signal.SIGHUP, signal.SIG_DFL),
):
    if signal.getsignal(number) is signal.SIG_IGN:
        signal.signal(number, handler)


def in_ci() -> bool:
    return os.environ.get("CI", "").lower() in ("1", "true")


def minutes_of(item: pytest.Item) -> float:
    """Return the minutes a verify test says it takes; 0 for other tests."""
    marker = item.get_closest_marker("verify")
    return 0.0 if marker is None else float(marker.kwargs.get("minutes", DEFAULT_MINUTES))


def turn(item: pytest.Item) -> tuple[float, bool]:
    """Return what sorts tests: short ones first, so that a time budget reaches as many as it can.

    Of those of the first tier whole systems come first, so that no worker waits at the end for another's.
    """
    return minutes_of(item), item.path.is_relative_to(ROOT / "tests" / "unit")


@functools.cache
def installed_packages() -> frozenset[str]:
    """Return the Debian packages of this machine; none where there is no dpkg."""
    command = ["dpkg-query", "-W", "-f=${db:Status-Status} ${Package}\n"]
    try:
        text = subprocess.run(command, capture_output=True, text=True, check=False).stdout
    except FileNotFoundError:
        return frozenset()
    return frozenset(line.split()[1] for line in text.splitlines() if line.startswith("installed "))


def lacking(item: pytest.Item) -> str:
    """Return what a check needs and this machine does not have; empty if it has everything."""
    for marker in item.iter_markers("needs"):
        if packages := [name for name in marker.args if name not in installed_packages()]:
            return f"{MISSING_PACKAGE}{packages[0]} is missing"
        variable = marker.kwargs.get("variable", "")
        if variable and not os.environ.get(variable):
            return f"{variable} is not set"
        if not marker.kwargs.get("when", True):
            return str(marker.kwargs["why"])
    return ""


def pytest_ignore_collect(collection_path: Path, config: pytest.Config) -> bool | None:
    """Leave folders that are foreign as a whole out of a run without them: each worker would import them."""
    foreign = any(collection_path.is_relative_to(ROOT / folder) for folder in FOREIGN)
    return True if foreign and "not foreign" in config.option.markexpr else None


def pytest_itemcollected(item: pytest.Item) -> None:
    needs = item.iter_markers("needs")
    place = item.path.relative_to(ROOT).as_posix() if item.path.is_relative_to(ROOT) else ""
    elsewhere = place.startswith(FOREIGN) or item.get_closest_marker("serial")
    if elsewhere or any(marker.args or "variable" in marker.kwargs for marker in needs):
        item.add_marker("foreign")


@pytest.hookimpl(trylast=True)
def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    if importlib.util.find_spec("rclpy") is None:  # ROS 2's environment has a run of its own
        other = {item for item in items if item.get_closest_marker("ros2")}
        config.hook.pytest_deselected(items=list(other))
        items[:] = [item for item in items if item not in other]
    lacks = {item: lacking(item) for item in items}
    gone = [
        item for item in items if lacks[item] and not (in_ci() and lacks[item].startswith(MISSING_PACKAGE))
    ]
    config.stash[_LEDGER].absent.update((item.nodeid, lacks[item]) for item in gone)
    config.hook.pytest_deselected(items=gone)
    absent = set(gone)
    items[:] = sorted((item for item in items if item not in absent), key=turn)


@pytest.hookimpl(tryfirst=True)
def pytest_runtest_protocol(item: pytest.Item) -> bool | None:
    deadline = os.environ.get("ROSPLC_DEADLINE")
    if deadline and time.time() + 60 * minutes_of(item) > float(deadline):
        item.config.stash[_LEDGER].unreached.append(item.nodeid)
        return True  # neither passed nor failed: nothing is reported
    return None


def pytest_runtest_setup(item: pytest.Item) -> None:
    if why := lacking(item):
        pytest.fail(f"{why}, and CI must run every check (.ci/debian-packages.txt)", pytrace=False)


def fail_in_ci(report: pytest.TestReport | pytest.CollectReport) -> None:
    if report.skipped and in_ci() and skip_reason(report).startswith(MISSING_PACKAGE):
        report.longrepr = f"{skip_reason(report)}, and CI must run every check (.ci/debian-packages.txt)"
        report.outcome = "failed"


@pytest.hookimpl(hookwrapper=True)
def pytest_runtest_makereport(item: pytest.Item) -> Any:
    outcome = yield
    fail_in_ci(outcome.get_result())


@pytest.hookimpl(hookwrapper=True)
def pytest_make_collect_report(collector: pytest.Collector) -> Any:
    outcome = yield
    fail_in_ci(outcome.get_result())


def skip_reason(report: pytest.TestReport | pytest.CollectReport) -> str:
    longrepr = report.longrepr
    text = longrepr[2] if isinstance(longrepr, tuple) else str(longrepr)
    return text.removeprefix("Skipped: ")


class Ledger:
    """Collects what a run did not do; the workers of pytest-xdist send theirs to the controller."""

    def __init__(self) -> None:
        self.absent: dict[str, str] = {}
        self.skipped: dict[str, str] = {}
        self.unreached: list[str] = []
        self.repeated: list[str] = []
        self.properties: list[tuple[str, object]] = []

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        if report.skipped and not hasattr(report, "wasxfail"):
            self.skipped[report.nodeid] = skip_reason(report)
        if report.outcome == "rerun":  # type: ignore[comparison-overlap]  # pytest-rerunfailures' own
            self.repeated.append(report.nodeid)
        self.properties += report.user_properties if report.when == "call" else []

    def pytest_collectreport(self, report: pytest.CollectReport) -> None:
        if report.skipped:  # a module whose library has no wheel for this machine
            self.absent[report.nodeid] = skip_reason(report)

    @pytest.hookimpl(optionalhook=True)
    def pytest_testnodedown(self, node: Any) -> None:
        sent = getattr(node, "workeroutput", {}).get("rosplc", ({}, []))
        self.absent.update(sent[0])
        self.unreached += sent[1]

    def pytest_sessionfinish(self, session: pytest.Session) -> None:
        output = getattr(session.config, "workeroutput", None)
        if output is not None:
            output["rosplc"] = (self.absent, self.unreached)
        elif path := os.environ.get("ROSPLC_REPORT"):
            Path(path).write_text(json.dumps(vars(self)))

    def pytest_terminal_summary(self, terminalreporter: Any) -> None:
        for nodeid, why in sorted(self.absent.items()):
            terminalreporter.write_line(f"NOT HERE {nodeid}: {why}")
        for nodeid in self.unreached:
            terminalreporter.write_line(f"NOT REACHED {nodeid}")
        for name, value in self.properties:
            terminalreporter.write_line(f"COUNTED {name}: {value}")


_LEDGER = pytest.StashKey[Ledger]()


def pytest_configure(config: pytest.Config) -> None:
    config.stash[_LEDGER] = Ledger()
    config.pluginmanager.register(config.stash[_LEDGER], "rosplc-ledger")
