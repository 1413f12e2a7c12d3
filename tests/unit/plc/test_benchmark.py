"""The generator's benchmark runs and reports in its documented shape."""

from __future__ import annotations

from benchmarks.bench_generate import run
from rosplc.model import TypeStore


def test_the_benchmark_reports_every_step():
    """One round gives times for each step, and the sizes of the text of every type."""
    (table,) = run(1, "humble")["tables"]
    facts = table["facts"]
    assert facts["types"] == len(TypeStore.bundled("humble").names())
    steps = {row["name"]: row for row in table["rows"]}
    assert {"layouts", "project", "st", "plcopen xml", "import script", "c header"} <= set(steps)
    assert all(row["worst"] >= row["median"] > 0 for row in steps.values())
    middle, largest, whole = (facts[f"text per type, {which}"] for which in ("median", "largest", "sum"))
    assert 0 < middle <= largest < whole <= facts["bytes of Structured Text"]
