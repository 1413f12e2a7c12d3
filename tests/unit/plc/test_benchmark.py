"""The generator's benchmark runs and reports in its documented shape."""

from __future__ import annotations

from benchmarks.bench_generate import run
from rosplc.model import TypeStore


def test_the_benchmark_reports_every_step():
    """One round gives times for each step, and the sizes of the text of every type."""
    result = run(1, "humble")
    assert result["types"] == len(TypeStore.bundled("humble").names())
    assert {"layouts", "project", "st", "plcopen xml", "import script", "c header"} <= set(result["steps"])
    assert all(row["worst_ms"] >= row["median_ms"] > 0 for row in result["steps"].values())
    text = result["text_bytes"]
    assert 0 < text["median"] <= text["largest"] < text["sum"] <= result["bytes"]["st"]
