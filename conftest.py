"""What every test run reports besides passes: checks skipped, and why; checks not reached.

`tools/checks.py` reads the report (a JSON file named by ``ROSPLC_REPORT``) and closes with it.
Two rules live here:

* ``pytest.skip("Debian package NAME is missing")`` is a skip on a laptop and a failure in CI,
  which can install what it needs.
* ``ROSPLC_DEADLINE`` (seconds since 1970) is when the time for ``verify`` tests ends. One that no
  longer fits is skipped as *not reached*, so it can never be taken for a pass.
"""

from __future__ import annotations

import json
import os
import re
import signal
import time
from pathlib import Path
from typing import Any

import pytest

MISSING_PACKAGE = re.compile(r"Debian package (\S+) is missing")
NOT_REACHED = "not reached within the time given"
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


def minutes_of(item: pytest.Item) -> float | None:
    """Return the minutes a verify test says it takes; None for other tests."""
    marker = item.get_closest_marker("verify")
    return None if marker is None else float(marker.kwargs.get("minutes", DEFAULT_MINUTES))


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    # Short ones first: a time budget then reaches as many as it can.
    items.sort(key=lambda item: minutes_of(item) or 0.0)


@pytest.hookimpl(tryfirst=True)
def pytest_runtest_setup(item: pytest.Item) -> None:
    deadline, minutes = os.environ.get("ROSPLC_DEADLINE"), minutes_of(item)
    if deadline and minutes is not None and time.time() + 60 * minutes > float(deadline):
        pytest.skip(NOT_REACHED)


def skip_reason(report: pytest.TestReport | pytest.CollectReport) -> str:
    longrepr = report.longrepr
    text = longrepr[2] if isinstance(longrepr, tuple) else str(longrepr)
    return text.removeprefix("Skipped: ")


def fail_in_ci(report: pytest.TestReport | pytest.CollectReport) -> None:
    if report.skipped and in_ci() and MISSING_PACKAGE.search(skip_reason(report)):
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


class Ledger:
    """Collects the skips of a run; with pytest-xdist it lives in the controller."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.skipped: dict[str, str] = {}

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        if report.skipped and not hasattr(report, "wasxfail"):
            self.skipped[report.nodeid] = skip_reason(report)

    def pytest_collectreport(self, report: pytest.CollectReport) -> None:
        if report.skipped:
            self.skipped[report.nodeid] = skip_reason(report)

    def pytest_sessionfinish(self) -> None:
        self.path.write_text(json.dumps(self.skipped))


def pytest_configure(config: pytest.Config) -> None:
    path = os.environ.get("ROSPLC_REPORT")
    if path and not hasattr(config, "workerinput"):
        config.pluginmanager.register(Ledger(Path(path)), "rosplc-ledger")
