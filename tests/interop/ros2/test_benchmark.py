"""The benchmark beside nodes of rclpy alone runs to its end; how fast anything is, no test says."""

from __future__ import annotations

import pytest

from benchmarks import bench_rclpy

pytestmark = [pytest.mark.ros2, pytest.mark.timeout(300)]


def test_nothing_is_lost() -> None:
    """Plain nodes and the bridge carry the same load, and none loses or changes a message."""
    tables = bench_rclpy.run(1, (2, 50, 0.5))["tables"]
    assert [[row["name"] for row in table["rows"]] for table in tables] == [
        [*names] for names in bench_rclpy.WAYS.values()
    ]
    assert [set(table["facts"].values()) for table in tables] == [{0}, {0}]
    assert all(row["median"] > 0 for table in tables for row in table["rows"])
