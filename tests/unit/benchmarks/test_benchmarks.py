"""Each benchmark runs to its end and reports in the common shape; how fast anything is, no test says."""

from __future__ import annotations

import json
import shutil
import sys

import pytest

from benchmarks import (
    bench_bridge,
    bench_classic,
    bench_realtime,
    bench_services,
    bench_transforms,
    bench_views,
    measure,
)
from generate_comparison import round_trips
from rosplc.layout import Limits
from tests.conformance.backends.registry import HARNESSES
from tests.interop.ros1.graph import PACKAGES


def rows(report: dict[str, object]) -> dict[str, dict[str, dict[str, float]]]:
    """Check a report's shape; return its rows by table and name."""
    json.dumps(report)
    assert {"processor", "kernel", "versions", "load_before", "load_after"} <= set(
        report["environment"]  # type: ignore[call-overload]
    )
    found = {}
    for table in report["tables"]:  # type: ignore[attr-defined]
        assert table["waiting"] and table["unit"]
        for row in table["rows"]:
            assert 0 <= row["median"] <= row["p99"] and row["count"] > 0
        found[table["title"]] = {row["name"]: row for row in table["rows"]}
        measure.print_table(table)
    return found


def test_turns_interleave_the_contenders() -> None:
    """Every contender measures once per round, in turn."""
    order: list[str] = []

    def contender(name: str) -> dict[str, list[float]]:
        order.append(name)
        return {name: [1.0, 2.0]}

    values = measure.turns({"a": lambda: contender("a"), "b": lambda: contender("b")}, 2)
    assert order == ["a", "b", "a", "b"]
    assert values == {"a": [1.0, 2.0, 1.0, 2.0], "b": [1.0, 2.0, 1.0, 2.0]}


def test_statistics_of_known_values() -> None:
    """Median, 99th percentile and the median ratio of turns are what arithmetic says."""
    values = [float(value) for value in range(1, 201)]
    assert measure.row("x", values) == {"name": "x", "median": 100.5, "p99": 198.0, "count": 200}
    assert measure.median_ratio([2.0, 9.0, 4.0], [1.0, 3.0, 1.0]) == 3.0


def test_the_structured_text_benchmark() -> None:
    """Both blocks move every message of the loop, and so does the core beside them."""
    pytest.importorskip("blark")
    if shutil.which("gcc") is None:
        pytest.skip("Debian package gcc is missing")
    from benchmarks import bench_st

    found = rows(bench_st.run(1, {"Twist": bench_st.Case("geometry_msgs/msg/Twist", Limits(), 64)}))
    table = found["Twist, one cycle"]
    assert set(table) == {"ST, read", "ST, write", "C core, read", "C core, write"}
    assert all(row["count"] == 20 and row["median"] > 0 for row in table.values())


def test_a_benchmark_prints_json(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    """``--json`` prints the report as it is."""
    monkeypatch.setattr(sys, "argv", ["bench", "--json", "--rounds", "3"])
    measure.main(lambda rounds: {"rounds": rounds}, "What it does.", 7)
    assert json.loads(capsys.readouterr().out) == {"rounds": 3}


def test_the_classic_benchmark() -> None:
    """Classic memory and channel carry the same messages both ways, also while the lock is held."""
    found = rows(bench_classic.run(1, messages=50, topics=2))
    assert len(found) == 3
    for title, table in found.items():
        names = {"classic", "channel"}
        assert set(table) == (names if title.startswith("CPU") else {*names, *(f"{n}, held" for n in names)})


def test_the_benchmark_of_services() -> None:
    """A bare server and both blocks answer each call, ratios have their spread, the page gets their rows."""
    pytest.importorskip("cyclonedds", reason="no wheel of cyclonedds for this machine")
    report = bench_services.run(2, ("dds",), 3)
    (table,) = rows(report).values()
    assert set(table) == {"bare", *bench_services.SCANS}
    assert all(0 < row["lowest"] <= row["to bare"] <= row["highest"] for row in table.values())
    assert all(row["count"] + row["unanswered"] == 6 for row in table.values())
    shown = round_trips(report).splitlines()
    assert [line.split(" | ")[0] for line in shown[2 : 2 + len(table)]] == [f"| {name}" for name in table]


def check_backends(titles: tuple[str, ...] | None) -> dict[str, object]:
    """Measure for moments only; return the report."""
    report = bench_bridge.run(1, titles, {100: 10}, (500,), 0.2, (1, 100, 0.5), 4)
    found = rows(report)
    there = {name.partition(",")[0] for name in found["Without loss, ROS to PLC"]}
    expected = {f"{title}, {name}" for title in there for name in ("bare", "bridge")}
    for way in ("ROS to PLC", "PLC to ROS (with the bridge's tick)"):
        table = found[f"{way}, PoseStamped of 200 B, 100 Hz"]
        assert set(table) - {"dds, without its tick"} == expected
        # The newest alone counts towards the PLC: a spinner that is held up sees fewer.
        assert all(0 < row["count"] <= 10 for row in table.values())
    for title in there:
        assert {"bridge", "ROS peer", "PLC"} <= set(found[f"{title}: 1 topics x 100 Hz each way"])
    return report


def test_the_benchmark_of_the_backends() -> None:
    """Bare and bridged messages are measured in both directions, with rates and CPU."""
    pytest.importorskip("cyclonedds", reason="no wheel of cyclonedds for this machine")
    report = check_backends(("dds",))
    found = rows(report)
    assert (
        "dds, without its tick" in found["PLC to ROS (with the bridge's tick), PoseStamped of 200 B, 100 Hz"]
    )
    assert {"bridge, no PLC", "bridge, a PLC scans"} <= set(found["4 quiet topics"])


def test_the_benchmark_beside_a_node_in_c() -> None:
    """The node in C and the bridge carry the same load, and neither loses or changes a message."""
    pytest.importorskip("cyclonedds", reason="no wheel of cyclonedds for this machine")
    if shutil.which("gcc") is None:
        pytest.skip("Debian package gcc is missing")
    from benchmarks import bench_dds

    report = bench_dds.run(1, (2, 100, 1.0), {100: 10})
    cpu, latency = rows(report).values()
    assert {"C node", "C node, user", "bridge", "bridge, system"} <= set(cpu)
    assert set(latency) == {"C node, 100 Hz", "bridge, 100 Hz"}
    facts = report["tables"][0]["facts"]
    assert facts["lost, C node"] == facts["lost, bridge"] == 0
    assert 0 < facts["memory, C node, MB (PSS)"] < facts["memory, bridge, MB (PSS)"]


def test_the_benchmark_towards_ros() -> None:
    """Both ways of looking hand over messages of all tasks, and CPU is read for quiet and active topics."""
    pytest.importorskip("cyclonedds", reason="no wheel of cyclonedds for this machine")
    if shutil.which("gcc") is None:
        pytest.skip("Debian package gcc is missing")
    from benchmarks import bench_to_ros

    report = bench_to_ros.run(1, (0.5, 0.5), (4,), (2, 4), ((2, 1), (4, 2)))
    assert all(table["rows"][0]["count"] for table in report["tables"])
    *cases, quiet, heads, active, spread = rows(report).values()
    assert all(set(table) == set(bench_to_ros.MODES) for table in cases)
    assert set(quiet) == {"4, no PLC", "4, a PLC scans"}
    assert set(heads) == {"4 heads"}
    assert set(active) == {"2 topics", "4 topics"}
    assert set(spread) == {"2 topics, 100 Hz", "4 topics, 50 Hz"}


@pytest.mark.needs(*PACKAGES)
def test_the_benchmark_beside_a_node_of_roscpp() -> None:
    """The node of roscpp and the bridge carry the same load; neither loses or changes a message."""
    from benchmarks import bench_dds, bench_ros1

    report = bench_dds.run(1, (2, 100, 1.0), {100: 10}, bench_ros1.OverRos1())
    cpu, latency = rows(report).values()
    assert {"C++ node", "C++ node, user", "bridge", "bridge, system"} <= set(cpu)
    assert set(latency) == {"C++ node, 100 Hz", "bridge, 100 Hz"}
    facts = report["tables"][0]["facts"]
    assert facts["lost, C++ node"] == facts["lost, bridge"] == 0
    assert 0 < facts["memory, C++ node, MB (PSS)"] < facts["memory, bridge, MB (PSS)"]


def test_the_benchmark_of_start_and_memory() -> None:
    """The first message arrives, and memory is read beside that of a participant."""
    pytest.importorskip("cyclonedds", reason="no wheel of cyclonedds for this machine")
    from benchmarks import bench_start

    ((_, table),) = rows(bench_start.run(1, 0.5, (2, 100))).items()
    assert table["start to first message, s"]["median"] > 0
    assert table["bridge, MB of memory (PSS)"]["ratio"] > 1


def test_the_benchmark_of_messages_with_fields() -> None:
    """Both ways come to the same values, for each type."""
    from benchmarks import bench_typed

    found = rows(bench_typed.run(1, 10))
    assert set(found) == {"geometry_msgs/msg/Twist", "sensor_msgs/msg/JointState"}
    assert all(set(table) == {"raw", "objects", "typed"} for table in found.values())


def test_the_benchmark_of_large_records() -> None:
    """What is taken is what was written, from C and from Python."""
    if shutil.which("gcc") is None:
        pytest.skip("Debian package gcc is missing")
    from benchmarks import bench_large

    ((_, table),) = rows(bench_large.run(1, 1 << 16)).items()
    channels = {"channel, C", "channel, Python, as bytes", "channel, Python, into a buffer"}
    assert set(table) == {"memcpy, C", "memcpy, Python"} | channels


def test_the_benchmark_of_images() -> None:
    """Small images arrive both ways through both, every byte of them."""
    pytest.importorskip("cyclonedds", reason="no wheel of cyclonedds for this machine")
    if shutil.which("gcc") is None:
        pytest.skip("Debian package gcc is missing")
    from benchmarks import bench_image

    report = bench_image.run(1, 30_000, (10, 1.0))
    ((_, table),) = rows(report).items()
    assert len(table) == 4
    assert set(report["tables"][0]["facts"].values()) == {0}


@pytest.mark.serial
@pytest.mark.verify(minutes=2)
def test_the_benchmark_of_all_backends() -> None:
    """Every backend that is installed takes its turn; the others are named with the reason."""
    report = check_backends(None)
    facts = next(t["facts"] for t in report["tables"] if t["title"].startswith("Without"))  # type: ignore[attr-defined]
    titles = {harness.backend for harness in HARNESSES} - {"memory"}
    named = {str(name).partition("-")[0] for name in facts}
    measured = {
        row["name"].partition(",")[0].partition("-")[0] for t in report["tables"] for row in t["rows"]
    }  # type: ignore[attr-defined]
    assert titles <= named | measured


@pytest.mark.serial
def test_the_real_time_benchmark() -> None:
    """Both bridges carry every message, on the machine as it is and beside endless loops."""
    if not bench_realtime.permitted():
        pytest.skip("this user may not use SCHED_FIFO")
    for table in rows(bench_realtime.run(1, count=20)).values():
        counts = [row["count"] for row in table.values()]
        assert counts[:2] == [20, 20] and min(counts[2:]) > 20


@pytest.mark.serial
@pytest.mark.verify(minutes=0.7)
def test_the_views_benchmark() -> None:
    """Each view runs beside a busy bridge, and a recorder accounts for every message at each rate."""
    report = bench_views.run(
        1, topics=2, rate=100, seconds=1.0, settle=0.5, steps=(200,), depths=(4,), browser=False
    )
    found = rows(report)
    for name in ("rosplc top", "rosplc web, a page", "rosplc record"):
        assert {f"bridge, beside {name}", f"{name} itself"} <= set(found["2 topics x 100 Hz: CPU"])
        assert f"beside {name}" in found["2 topics x 100 Hz: PLC → bridge → DDS"]
    recording = report["tables"][-1]
    assert recording["facts"]["losses that were not counted"] == 0


def test_the_transforms_benchmark() -> None:
    """Every frame is received, and the lookups find a pose."""
    (table,) = rows(bench_transforms.run(2)).values()
    assert table[bench_transforms.POSE]["count"] == 20
    assert all(row["median"] > 0 for row in table.values())
