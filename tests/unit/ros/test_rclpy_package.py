"""The ROS 2 package: colcon builds it, its files name what exists, the launch file says what it means."""

from __future__ import annotations

import ast
import importlib.util
import os
import re
import runpy
import shutil
import subprocess
from pathlib import Path
from typing import Any

import pytest
from lxml import etree

from rosplc import __version__
from rosplc.config import load_project
from tests.doubles.ros2 import double

pytestmark = pytest.mark.verifies("colcon", real="colcon, without ROS")

PACKAGE = Path(__file__).parents[3] / "packaging" / "ros2" / "rosplc_bridge"


@pytest.mark.timeout(180)
@pytest.mark.needs("colcon", "python3-colcon-ros", "python3-colcon-recursive-crawl")
def test_colcon_builds_it(tmp_path: Path) -> None:
    """`colcon build` makes an installation in which ROS finds the package, program and launch file."""
    colcon = shutil.which("colcon", path="/usr/bin:/bin")
    assert colcon is not None
    shutil.copytree(
        PACKAGE,
        tmp_path / "src" / "rosplc_bridge",
        ignore=shutil.ignore_patterns("__pycache__", "*.egg-info"),
    )
    environment = {"PATH": "/usr/bin:/bin", "HOME": str(tmp_path), "COLCON_HOME": str(tmp_path / "colcon")}
    built = subprocess.run(
        [colcon, "build", "--base-paths", "src"],
        cwd=tmp_path,
        env=environment,
        capture_output=True,
        text=True,
    )
    assert built.returncode == 0, built.stdout + built.stderr
    root = tmp_path / "install" / "rosplc_bridge"
    assert (root / "share/ament_index/resource_index/packages/rosplc_bridge").is_file()
    for file in ("package.xml", "launch/bridge.launch.py", "config/rosplc.yaml"):
        assert (root / "share/rosplc_bridge" / file).read_bytes() == (PACKAGE / file).read_bytes()
    program = root / "lib/rosplc_bridge/bridge"
    assert os.access(program, os.X_OK)
    # What makes `ros2 run` and `import` find it, once the setup.bash is sourced.
    assert "AMENT_PREFIX_PATH" in (root / "share/rosplc_bridge/hook/ament_prefix_path.sh").read_text()
    found = sorted(path.name for path in root.glob("lib/python*/site-packages/rosplc_bridge/*.py"))
    assert found == ["__init__.py", "lifecycle_node.py", "main.py"]
    points = next(root.glob("lib/python*/site-packages/rosplc_bridge-*.egg-info/entry_points.txt"))
    assert "bridge = rosplc_bridge.main:main" in points.read_text()


def test_manifest_names_every_package_that_is_imported() -> None:
    """What the package's files import is in package.xml, and its version is rosplc's."""
    manifest = etree.parse(str(PACKAGE / "package.xml")).getroot()
    declared = {element.text for element in manifest.iter("exec_depend")}
    imported = set()
    for path in PACKAGE.rglob("*.py"):
        if path.name == "setup.py":
            continue
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.ImportFrom) and node.module:
                imported.add(node.module.split(".")[0])
            elif isinstance(node, ast.Import):
                imported.update(alias.name.split(".")[0] for alias in node.names)
    standard = {"__future__", "collections", "logging", "sys", "rosplc", "rosplc_bridge"}
    assert imported - standard <= declared
    assert manifest.findtext("version") == re.match(r"\d+\.\d+\.\d+", __version__ + ".0")[0]  # type: ignore[index]
    assert manifest.find("export").findtext("build_type") == "ament_python"  # type: ignore[union-attr]


def test_configuration_of_the_package_is_valid() -> None:
    """The configuration that comes with the package can be used as it is, with packages it depends on."""
    project = load_project(PACKAGE / "config" / "rosplc.yaml")
    assert project.config.settings.ros.backend == "rclpy"
    manifest = etree.parse(str(PACKAGE / "package.xml")).getroot()
    declared = {element.text for element in manifest.iter("exec_depend")}
    assert {plan.type_name.split("/")[0] for plan in project.topics} <= declared


def description(name: str) -> Any:
    return runpy.run_path(str(PACKAGE / "launch" / name))["generate_launch_description"]()


def test_launch_file_starts_configures_and_activates() -> None:
    """The node gets the configuration as its parameter, then both transitions, if autostart is on."""
    with double():
        parts = description("bridge.launch.py").entities
    arguments = {part.name: part for part in parts if type(part).__name__ == "DeclareLaunchArgument"}
    assert set(arguments) == {"config", "name", "namespace", "autostart"}
    assert arguments["config"].default_value.parts[1:] == ["config", "rosplc.yaml"]
    (node,) = (part for part in parts if type(part).__name__ == "LifecycleNode")
    assert (node.package, node.executable) == ("rosplc_bridge", "bridge")
    (parameters,) = node.parameters
    assert parameters["config"].value.name == "config"
    assert parameters["config"].value_type is str
    (configure,) = (part for part in parts if type(part).__name__ == "EmitEvent")
    assert (configure.event.transition_id, configure.condition.predicate.name) == (1, "autostart")
    assert configure.event.matches(node)
    (register,) = (part for part in parts if type(part).__name__ == "RegisterEventHandler")
    handler = register.event_handler
    assert (handler.start_state, handler.goal_state) == ("configuring", "inactive")
    assert [action.event.transition_id for action in handler.entities] == [3]
    assert register.condition.predicate.name == "autostart"
    assert handler.handle_once, "a later configure by hand does not activate the node"


@pytest.mark.needs(when=importlib.util.find_spec("rclpy") is None, why="the real rclpy is here")
def test_program_serves_the_node_until_the_context_ends(monkeypatch: pytest.MonkeyPatch) -> None:
    """`ros2 run rosplc_bridge bridge` spins the lifecycle node on the process's own context."""
    monkeypatch.setattr("sys.argv", ["bridge", "--ros-args", "-r", "__node:=cell9"])
    seen = []
    with double("jazzy", [str(PACKAGE)]) as rclpy:

        def spin(node: Any, executor: Any = None) -> None:
            seen.append(node.get_fully_qualified_name())
            executors = importlib.import_module("rclpy.executors")
            executor = executors.SingleThreadedExecutor(context=node.context)
            executor.create_task(node.context.shutdown)  # as the signal handler does
            original(node, executor)

        original = rclpy.spin
        monkeypatch.setattr(rclpy, "spin", spin)
        main = importlib.import_module("rosplc_bridge.main").main
        assert main() == 0
    assert seen == ["/cell9"]
