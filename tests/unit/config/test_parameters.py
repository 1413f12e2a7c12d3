"""Parameters of a configuration: what is refused, and what the PLC's message has."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from rosplc.config import ConfigErrors, parse_config, resolve
from rosplc.config.parameters import CURRENT, WANTED, given_values
from rosplc.errors import ConfigError
from rosplc.shm import Direction

HEAD = "ros: {backend: memory}\nparameters:\n  declare:\n    "
DECLARED = """max.speed: {type: double, value: 1, range: [0, 2, 0.5]}
    Names: {type: string_array, value: [a], capacity: 3, length: 7}
    count: {type: integer, value: 3, read_only: true}
"""


def test_two_topics_of_one_message() -> None:
    """A field per parameter, with its capacities; one object each way, which no topic of ROS has."""
    project = resolve(parse_config(HEAD + DECLARED))
    plan = project.parameters
    assert plan is not None
    assert plan.fields == {"max.speed": "max_speed", "Names": "names", "count": "count"}
    assert [each.value for each in plan.declared] == [1.0, ["a"], 3]
    assert plan.declared[0].range == (0.0, 2.0, 0.5)
    capacities = {path: node.capacity for path, _, node in plan.layout.fields() if hasattr(node, "capacity")}
    assert capacities == {"values.names": 3, "values.names[]": 7}
    wanted, current = project.topics
    assert (wanted.topic, wanted.direction, wanted.latched) == (WANTED, Direction.TO_PLC, True)
    assert (current.topic, current.direction, current.latched) == (CURRENT, Direction.TO_ROS, True)
    assert all(each.own == "parameters" and each.layout == plan.layout for each in project.topics)


@pytest.mark.parametrize(
    ("declared", "words"),
    [
        ("a: {type: double, value: 3, range: [0, 2]}", "a must be within 0.0 … 2.0"),
        ("a: {type: integer, range: [1, 2]}", "a must be within 1 … 2"),
        ("a: {type: string, range: [1, 2]}", "a parameter of type string cannot have a range"),
        ("a: {type: integer, range: [2, 1]}", "the range [2, 1] is empty"),
        ("a: {type: integer, range: [0, 1.5]}", "1.5 is not of type integer"),
        ("a: {type: bool, value: 1}", "1 is not of type bool"),
        ("a: {type: integer, value: true}", "True is not of type integer"),
        ("a: {type: integer, value: 9223372036854775808}", "is not of type integer"),
        ("a: {type: double, value: .nan}", "'.nan' is not of type double"),
        ("a: {type: byte_array, value: [256]}", "256 is not of type byte"),
        ("a: {type: string_array, value: b}", "'b' is not of type string_array"),
        ("a: {type: string, value: longer, length: 3}", "the text for a has more than 3 bytes"),
        ("a: {type: int}", "did you mean 'integer'?"),
        ("a.b: {type: bool}\n    a_b: {type: bool}", "a_b and a.b are both a_b in the PLC"),
        ("a: {type: bool}\n  task: Fast", "task 'Fast' is not defined"),
        (
            "a: {type: bool}\ntopics: {/parameters/wanted: {type: std_msgs/msg/Bool, to: plc}}",
            "itself already carries",
        ),
    ],
)
def test_refusals(declared: str, words: str) -> None:
    """Each at its place, with words."""
    with pytest.raises(ConfigErrors) as caught:
        resolve(parse_config(HEAD + declared))
    assert words in str(caught.value)


def test_names_in_ros_1() -> None:
    """Groups are namespaces of the master there, which have no value."""
    head = "ros: {distro: noetic}\nparameters: {declare: "
    assert resolve(parse_config(head + "{a: {type: bool}, ab.c: {type: byte_array}}}")).parameters is not None
    with pytest.raises(ConfigErrors, match=r"in ROS 1, a cannot also be a namespace"):
        resolve(parse_config(head + "{a: {type: bool}, a.b: {type: bool}}}"))


def given(arguments: list[str]) -> dict[str, Any]:
    plan = resolve(parse_config(HEAD + DECLARED)).parameters
    assert plan is not None
    return given_values(arguments, "/robot/rosplc_cell", plan.declared)


def test_what_a_command_line_gives(tmp_path: Path) -> None:
    """Files by the node's name and by patterns, then ``-p``; the rest is ignored."""
    path = tmp_path / "params.yaml"
    path.write_text(
        "/**: {ros__parameters: {max: {speed: 0.5}, other: 1}}\n"
        "robot: {rosplc_cell: {ros__parameters: {Names: [b, c]}}}\n"
        "/*/rosplc_cell: {ros__parameters: {count: 4}}\n"
        "rosplc_cell: {ros__parameters: {count: 5}}\n"
    )
    arguments = ["--params-file", str(path), "-e", "/cell1"]
    assert given(arguments) == {"max.speed": 0.5, "Names": ["b", "c"], "count": 4}
    more = [*arguments, "-p", "rosplc_cell:count:=7", "-p", "other:count:=8", "-p", "max.speed:=2"]
    assert given(more) == {"max.speed": 2.0, "Names": ["b", "c"], "count": 7}


@pytest.mark.parametrize(
    "arguments", [["-p", "count:=x"], ["-p", "max.speed:=7"], ["-p", "count:=["], ["--params-file", "/none"]]
)
def test_a_wrong_command_line(arguments: list[str]) -> None:
    """CFG011."""
    with pytest.raises(ConfigError) as caught:
        given(arguments)
    assert caught.value.code == "CFG011"
