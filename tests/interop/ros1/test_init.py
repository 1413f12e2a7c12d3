"""A configuration from a running ROS 1 graph."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path

import pytest
from typer.testing import CliRunner

from rosplc.cli.app import app
from rosplc.config import load_project
from rosplc.ros import LATCHED, Qos
from tests.interop.ros1.graph import PACKAGES, Graph, lend
from tests.interop.ros1.test_peers import PART, part_defines, string

pytestmark = [
    pytest.mark.needs(*PACKAGES),
    pytest.mark.timeout(120),
    pytest.mark.verifies("init", real="ROS 1 nodes"),
]
TWIST = "geometry_msgs/msg/Twist"


@pytest.fixture
def ros1(monkeypatch: pytest.MonkeyPatch) -> Iterator[Graph]:
    with lend() as graph:
        for name, value in graph.environment.items():
            monkeypatch.setenv(name, value)
        for name in ("ROS_DISTRO", "ROS_PACKAGE_PATH"):
            monkeypatch.delenv(name, raising=False)
        yield graph


def test_roscpp_robot_gives_a_configuration_with_its_own_types(ros1: Graph, tmp_path: Path) -> None:
    """ROS_MASTER_URI is enough: a latched custom type is learnt from its publisher, saved and measured."""
    robot = ros1.peer("roscpp", "cpp", *part_defines())
    parts = robot.advertise("/parts", PART, LATCHED)
    robot.subscribe("/cmd_vel", TWIST, Qos())
    parts.write(bytes(12) + string("base") + string("S-" + "7" * 98) + bytes(56) + bytes(4) + b"\1")
    out = tmp_path / "rosplc.yaml"
    command = ["init", "--all", "--listen", "3s", "--output", str(out), "--json"]
    result = CliRunner().invoke(app, command)
    assert result.exit_code == 0, result.output
    document = json.loads(result.stdout)
    assert document["ros"] == {"backend": "auto", "distro": "noetic"}
    assert any("ROS_MASTER_URI, ROS_IP are set in this shell" in note for note in document["notes"])
    assert document["definitions"] == {PART: "node /cpp"}
    project = load_project(out)
    assert {plan.topic: (plan.type_name, int(plan.direction)) for plan in project.topics} == {
        "/parts": (PART, 1),
        "/cmd_vel": (TWIST, 2),
    }
    plan = project.topic("/parts")
    assert plan.latched
    assert plan.layout.limits.fields["serial"] == 208
    assert "float32[] weights" in (tmp_path / "msg/cell_msgs/msg/Part.msg").read_text()


def test_without_a_master_it_says_so(ros1: Graph, tmp_path: Path) -> None:
    """The error is that of the bridge: the master does not answer."""
    ros1.kill_master()
    command = ["init", "--all", "--look", "1s", "--output", str(tmp_path / "rosplc.yaml")]
    result = CliRunner().invoke(app, command)
    assert result.exit_code == 1
    assert "ROS014" in result.stderr
    assert list(tmp_path.iterdir()) == []
