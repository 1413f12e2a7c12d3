"""From campaigns' JSON to tables: the rounds are counted, and the percentiles are those of the rounds."""

from __future__ import annotations

from typing import Any

import pytest

from tests.soak.results import compact, percentile, recovery_table, run_table


def run(recoveries: list[float], **more: Any) -> dict[str, Any]:
    """Give a campaign's JSON with one kind of fault."""
    return {
        "seed": 5, "backend": "dds", "plc": "python", "spared": [], "peers": "forked",
        "seconds": 60.0, "cpu_s": 9.0,
        "messages": 1234, "machine": {"nice": 5}, "violations": [], "skipped": {},
        "log": [
            {"number": n, "fault": "flood", "recovery_s": at, "fault_s": 1.0, "check_s": 0.1}
            for n, at in enumerate(recoveries, 1)
        ],
        "samples": [{"round": n, "load": 1.5, "objects": 8} for n in range(1, len(recoveries) + 1)],
    } | more  # fmt: skip


def test_percentiles_are_values_that_occurred() -> None:
    """The 99th percentile of a hundred and one values is the hundredth."""
    assert percentile([float(n) for n in range(101)], 0.99) == 99
    assert percentile([3.0], 0.99) == 3


def test_runs_of_one_kind_are_put_together() -> None:
    """Two campaigns of a kind give one column, another priority its own, and peers from scratch none."""
    runs = [run([1.0, 2.0]), run([3.0]), run([9.0], machine={"nice": -10}), run([8.0], peers="started")]
    head, _, row = recovery_table([compact(one) for one in runs])
    assert head == "| fault | DDS: rounds | p50 | p99 | DDS, nice -10: rounds | p50 | p99 |"
    assert row == "| flood | 3 | 2.00 s | 3.00 s | 1 | 9.00 s | 9.00 s |"


@pytest.mark.parametrize(("violations", "shown"), [([], "| 0 |"), (["torn"], "| 1 |")])
def test_violations_are_shown(violations: list[str], shown: str) -> None:
    """A run's row says how many rounds it had and how often something did not hold."""
    row = run_table([compact(run([1.0, 2.0], violations=violations))])[-1]
    assert row.startswith("| DDS | 5 | 5 | forked | 2 |")
    assert shown in row
