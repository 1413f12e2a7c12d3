"""The section ``ros`` together with a command line and an environment."""

from __future__ import annotations

import logging
from pathlib import Path

import pytest

from rosplc.bridge import Bridge
from rosplc.bridge.ros_side import RosSide, choose_backend
from rosplc.config import ConfigErrors, parse_config, resolve
from rosplc.errors import BackendError
from rosplc.ros import Remapping, RosArguments
from rosplc.ros.memory import MemoryBackend
from rosplc.shm import Namespace
from tests.interop.graphs import free_domain


def side(ros: str, arguments: str = "") -> RosSide:
    """Return what a section and a command line lead to."""
    config = parse_config(f"bridge: cell-1\nros: {ros}\n", name="c.yaml")
    return RosSide(config, RosArguments.parse(arguments.split()))


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("ros:\n  backend: dds\n  distro: noetic\n", [("CFG004", "c.yaml:2: ros.backend")]),
        ("ros:\n  backend: rclpy\n  distro: noetic\n", [("CFG004", "c.yaml:2: ros.backend")]),
        ("ros:\n  distro: jazzy\n  backend: rospy\n", [("CFG004", "c.yaml:3: ros.backend")]),
        ("ros:\n  backend: rospy\n", [("CFG004", "c.yaml:2: ros.backend")]),
        ("ros:\n  backend: dds\n  zenoh: {mode: peer}\n", [("CFG004", "c.yaml:3: ros.zenoh")]),
        ("ros:\n  distro: noetic\n  rclpy: {}\n", [("CFG004", "c.yaml:3: ros.rclpy")]),
        ("ros:\n  zenoh:\n    config: none.json5\n", [("CFG001", "c.yaml:3: ros.zenoh.config")]),
    ],
)
def test_contradictions_are_errors(text: str, expected: list[tuple[str, str]]) -> None:
    """Distribution, backend and a backend's settings that exclude each other are named with line and key."""
    with pytest.raises(ConfigErrors) as caught:
        resolve(parse_config(text, name="c.yaml"))
    assert [(error.code, error.where) for error in caught.value.errors] == expected


@pytest.mark.parametrize(
    ("ros", "place"),
    [
        ("{zenoh: {mode: router}}", "ros.zenoh.mode"),
        ("{zenoh: {connect: [localhost]}}", "ros.zenoh.connect[0]"),
        ("{zenoh: {listen: tcp/a}}", "ros.zenoh.listen"),
        ("{zenoh: {lisen: []}}", "ros.zenoh.lisen"),
        ("{remap: {/a b: /c}}", "ros.remap./a b"),
        ("{remap: {/a: /1}}", "ros.remap./a"),
        ("{rclpy: {parameters: {a: 1}}}", "ros.rclpy.parameters.a"),
    ],
)
def test_bad_values_are_named(ros: str, place: str) -> None:
    """Each key of the section is checked, and an error names its place."""
    with pytest.raises(ConfigErrors) as caught:
        parse_config(f"ros: {ros}\n", name="c.yaml")
    for error in caught.value.errors:
        assert error.where == f"c.yaml:1: {place}"


def test_command_line_comes_before_configuration(monkeypatch: pytest.MonkeyPatch) -> None:
    """Names come from the arguments, else from the file, else from ROS 1's environment."""
    monkeypatch.setenv("ROS_NAMESPACE", "env")
    assert side("{}").names() == ("rosplc_cell_1", "/", {})
    assert side("{distro: noetic}").names() == ("rosplc_cell_1", "/env", {})
    assert side("{distro: noetic, namespace: /}").names()[1] == "/"
    ros = "{node_name: cell, namespace: /file, remap: {/a: /b, /c: /d}}"
    assert side(ros).names() == ("cell", "/file", {"/a": "/b", "/c": "/d"})
    given = "-r /a:=/x -r __ns:=/line -r cell:__node:=other -r wrong:/c:=/y"
    assert side(ros, given).names() == ("other", "/line", {"/a": "/x", "/c": "/d"})


def test_backends_get_their_own_settings(tmp_path: Path) -> None:
    """Each backend gets its section, with absolute paths, and rclpy what is left of the command line."""
    ros = "{zenoh: {connect: [tcp/r:7447], config: z.json5}, rclpy: {ros_args: [--enclave, /a]}}"
    found = side(ros, "-p x:=1 -r a:=b")
    assert found.options("zenoh") == {"connect": ("tcp/r:7447",), "config": str(Path("z.json5").absolute())}
    rclpy = found.options("rclpy")
    assert rclpy["ros_args"] == ("--enclave", "/a", "-p", "x:=1")
    assert rclpy["parameter_services"] is False
    assert found.shown() == {"bridge": "cell-1", "config": str(Path("c.yaml").absolute()), "topics": []}
    assert found.options("dds") == {}


def test_a_named_backend_is_taken_as_it_is() -> None:
    """Only ``auto`` asks environment and machine."""
    config = parse_config("ros: {backend: memory}\n")
    assert choose_backend(config, {"RMW_IMPLEMENTATION": "rmw_zenoh_cpp"}).name == "memory"
    config = parse_config("ros: {backend: auto}\n")
    with pytest.raises(BackendError, match="ROS001"):
        choose_backend(config, {"RMW_IMPLEMENTATION": "rmw_unknown_cpp", "PATH": ""})


def test_bridge_takes_its_names_from_the_command_line(
    shm_namespace: Namespace, caplog: pytest.LogCaptureFixture
) -> None:
    """A remapped bridge is another node on another topic; the PLC's names stay."""
    caplog.set_level(logging.INFO, "rosplc.bridge")
    with free_domain() as domain:
        text = (
            f"prefix: {shm_namespace.prefix}\nros: {{backend: memory, domain: {domain}}}\n"
            "topics:\n  /cmd_vel: {type: geometry_msgs/msg/Twist, to: plc}\n"
        )
        given = "-r /cmd_vel:=/base/cmd_vel -r __ns:=/r1 -r __node:=n -e /a"
        arguments = RosArguments.parse(given.split())
        with Bridge(parse_config(text), arguments=arguments) as bridge:
            assert isinstance(bridge.backend, MemoryBackend)
            assert bridge.backend.node == "/r1/n"
            assert "/base/cmd_vel" in {status.topic for status in bridge.backend.status()}
            assert shm_namespace.path("/cmd_vel").exists()
            assert bridge.status().backend_why == "memory, because ros.backend selects it"
    assert "ignores the ROS arguments -e /a" in caplog.text


def test_nothing_given_changes_nothing() -> None:
    """Without arguments no name is replaced."""
    assert RosArguments().for_node("n") == Remapping()
