"""The codec's benchmark runs and reports in its documented shape."""

from __future__ import annotations

from benchmarks.bench_codec import MESSAGES, run


def test_the_benchmark_reports_every_contender() -> None:
    """One round gives medians, 99th percentiles and ratios for each type and contender."""
    result = run(1)
    assert set(result) == set(MESSAGES)
    for rows in result.values():
        assert {"rosbags + struct", "decode (plan)", "encode (plan)"} <= set(rows)
        assert all(row["median_us"] > 0 and row["p99_us"] > 0 for row in rows.values())
        assert rows["rosbags + struct"]["ratio"] == 1
