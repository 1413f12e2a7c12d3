"""The codec's benchmark runs and reports in its documented shape."""

from __future__ import annotations

from benchmarks.bench_codec import MESSAGES, run


def test_the_benchmark_reports_every_contender() -> None:
    """One round gives medians, 99th percentiles and ratios for each type and contender."""
    tables = run(1)["tables"]
    assert [table["title"] for table in tables] == list(MESSAGES)
    for table in tables:
        rows = {row["name"]: row for row in table["rows"]}
        assert {"rosbags + struct", "decode (plan)", "encode (plan)"} <= set(rows)
        assert all(row["median"] > 0 and row["p99"] > 0 for row in rows.values())
        # Plainly divided: nothing is subtracted on either side.
        base, plan = rows["rosbags + struct"]["median"], rows["decode (plan)"]["median"]
        assert rows["decode (plan)"]["times faster"] == base / plan
        assert rows["rosbags + struct"]["times faster"] == 1
