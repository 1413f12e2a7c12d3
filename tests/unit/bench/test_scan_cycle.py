"""The scan-cycle view runs, tells torn messages from whole ones, and says what it could not do."""

from __future__ import annotations

import json
import shutil
import subprocess
from contextlib import ExitStack
from pathlib import Path

import pytest

from rosplc_bench import scan_cycle
from rosplc_bench.report import table_lines
from rosplc_bench.run import EFFORTS, Context
from rosplc_bench.scan_cycle import STALL_NS, Condition


@pytest.fixture
def context(tmp_path: Path) -> Context:
    """Give the context of a run."""
    if shutil.which("gcc") is None:
        pytest.skip("Debian package gcc is missing")
    if shutil.which("pkg-config") is None:
        pytest.skip("Debian package pkg-config is missing")
    if subprocess.run(["pkg-config", "--exists", "libmodbus"], check=False).returncode:
        pytest.skip("Debian package libmodbus-dev is missing")
    return Context(EFFORTS["default"], tmp_path, tmp_path, (0,))


@pytest.mark.foreign
def test_every_method_and_condition(context: Context, monkeypatch: pytest.MonkeyPatch) -> None:
    """Every method exchanges messages in every condition, rosplc none that is torn, and the page shows it."""
    monkeypatch.setitem(scan_cycle._EFFORTS, "default", (1, 0.02, 5, 20))
    monkeypatch.setattr(
        scan_cycle, "_conditions", lambda _: [Condition(1), Condition(2, hog=True, fifo=True)]
    )
    data = json.loads(json.dumps(scan_cycle.run(context)))
    assert not context.failures
    assert {one["method"] for one in data["runs"]} == set(scan_cycle.NAMES)
    assert len(data["runs"]) == 2 * len(scan_cycle.NAMES)
    for one in data["runs"]:
        assert one["late_ns"]["count"] == one["calls_ns"]["count"] == one["scans"]
        if one["method"].startswith("rosplc"):
            assert one["torn"] == 0
    assert {one["method"] for one in data["stalls"]} == {
        "rosplc",
        "semaphore",
        "plain",
        "modbus-slave",
        "modbus-master",
    }
    page = scan_cycle.SECTION.render(data)
    for table in page.tables:
        assert table.waiting and table.rows
        assert all(len(row) == len(table.header) for row in table.rows)
        assert list(table_lines(table))
    refused = any(one["scheduling"] == "refused" for one in data["runs"])
    assert refused == any("SCHED_FIFO" in skip.what for skip in context.skips)


def test_who_stands_still_inside_a_message(context: Context, monkeypatch: pytest.MonkeyPatch) -> None:
    """The control: without a lock half a message is seen; with one the task waits; rosplc's does neither."""
    wanted = ("rosplc", "semaphore", "plain")
    context.only = wanted
    with ExitStack() as stack:
        methods = {one.name: one for one in scan_cycle.Starter(context, stack).methods()}
        assert set(methods) == set(wanted)
        found = {name: scan_cycle.stall(method, scans=1000) for name, method in methods.items()}
    assert found["plain"]["torn"] > 0
    assert found["rosplc"]["torn"] == found["semaphore"]["torn"] == 0
    assert found["semaphore"]["longest_ns"] > STALL_NS / 2


def test_a_summary_keeps_measured_values() -> None:
    """Median, p99 and the largest are values that were measured."""
    assert scan_cycle.summary([]) == {"count": 0}
    assert scan_cycle.summary([5]) == {"count": 1, "p50": 5, "p99": 5, "max": 5}
    assert scan_cycle.summary(list(range(1, 201))) == {"count": 200, "p50": 100, "p99": 198, "max": 200}


def test_a_refused_priority_is_said(context: Context) -> None:
    """Where SCHED_FIFO is refused the run says so, and rosplc's torn messages would fail it."""
    one = {"method": "rosplc", "scheduling": "refused", "torn": 1}
    scan_cycle._check(context, [one])
    assert [skip.what for skip in context.skips] == ["scan cycle with SCHED_FIFO"]
    assert len(context.failures) == 1
