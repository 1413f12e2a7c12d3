"""ROS arguments on a command line."""

from __future__ import annotations

import pytest

from rosplc.errors import ConfigError
from rosplc.ros import Remapping, RosArguments, split_arguments


def test_ros_arguments_are_told_from_the_program_s_own() -> None:
    """What stands between ``--ros-args`` and ``--`` is ROS's, and so is every ``from:=to`` elsewhere."""
    given = [
        "rosplc.yaml",
        "--ros-args",
        "-r",
        "a:=b",
        "--",
        "--status",
        "2",
        "c:=d",
        "--ros-args",
        "-p",
        "x:=1",
    ]
    assert split_arguments(given) == (
        ["-r", "a:=b", "c:=d", "-p", "x:=1"],
        ["rosplc.yaml", "--status", "2"],
    )


def test_rules_of_ros_2_apply() -> None:
    """Topics, node and namespace are renamed; a rule with a node's name holds for that node alone."""
    given = "-r /a:=/b --remap __ns:=/robot1 -r __node:=cell -r /a:=/late -r other:c:=d -r n:e:=f"
    found = RosArguments.parse(given.split())
    assert found.for_node("n") == Remapping({"/a": "/b", "e": "f"}, "cell", "/robot1")
    assert found.for_node("m") == Remapping({"/a": "/b"}, "cell", "/robot1")


def test_arguments_of_ros_1_apply() -> None:
    """Names, namespace (relative too), parameters and addresses are taken as ROS 1 programs take them."""
    given = (
        "chatter:=/b __name:=cell __ns:=robot1 _rate:=5 __master:=http://h:11311 __ip:=10.0.0.1 __log:=/tmp/x"
    )
    found = RosArguments.parse(given.split())
    assert found.for_node("n") == Remapping({"chatter": "/b"}, "cell", "/robot1")
    assert found.environment == {"ROS_MASTER_URI": "http://h:11311", "ROS_IP": "10.0.0.1"}
    assert found.others == ("-p", "rate:=5")


def test_what_concerns_the_client_library_is_kept() -> None:
    """Parameters, enclave and log settings are handed on as they are; the level is understood."""
    given = "-p use_sim_time:=true --params-file p.yaml -e /cell --log-level warn --disable-rosout-logs"
    found = RosArguments.parse(given.split())
    assert found.others == tuple(given.split())
    assert found.log_level == "warn"
    assert RosArguments.parse(["--log-level", "rcl:=debug"]).log_level is None


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["-r", "a"], "form from:=to"),
        (["-r", "a:="], "form from:=to"),
        (["-r", ":=b"], "form from:=to"),
        (["-r"], "value is missing"),
        (["-r", "a b:=c"], "letters, digits"),
        (["-r", "/a:=/1"], "not start with a digit"),
        (["-r", "__node:=a/b"], "node name"),
        (["-r", "__ns:=a"], "must start with /"),
        (["-r", "__nod:=a"], "special name"),
        (["-r", "1:a:=b"], "not a valid node name"),
        (["-p", "x"], "form from:=to"),
        (["-p", "a b:=1"], "a parameter has the form"),
        (["--log-level", "loud"], "use debug"),
        (["--params"], "unknown ROS argument"),
        (["stray"], "unknown ROS argument"),
        (["__name:=a-b"], "node name"),
    ],
    ids=" ".join,
)
def test_bad_arguments_are_refused(arguments: list[str], words: str) -> None:
    """An argument that is not valid is named, with what would be."""
    with pytest.raises(ConfigError, match=words) as refused:
        RosArguments.parse(arguments)
    assert (refused.value.code, refused.value.where) == ("CFG011", "command line")
