"""What ``rosplc check`` tells a technician and an integrator."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from typer.testing import CliRunner

from rosplc.cli.app import app
from rosplc.config import parse_config, resolve
from rosplc.project import check
from tests.command import rosplc

INT = "std_msgs/msg/Int32"


def explained(folder: Path, text: str) -> str:
    path = folder / "rosplc.yaml"
    path.write_text(text)
    result = CliRunner().invoke(app, ["check", "-v", str(path)])
    assert result.exit_code == 0, result.output
    return result.output


def made(text: str):
    return check(resolve(parse_config(text)))


def test_types_that_cannot_be_used_are_listed(tmp_path: Path) -> None:
    """A whole workspace is no error, and what of it cannot be carried is named, as text and as JSON."""
    package = tmp_path / "ws/my_msgs/msg"
    package.mkdir(parents=True)
    for name, definition in {"Good": "int8 x", "Wide": "wstring text", "Needs": "Wide wide"}.items():
        (package / f"{name}.msg").write_text(f"{definition}\n")
    path = tmp_path / "rosplc.yaml"
    path.write_text(
        "ros: {backend: memory}\ntypes: {paths: [ws]}\ntopics: {/a: {type: my_msgs/msg/Good, to: plc}}\n"
    )
    mistake = f"{package / 'Wide.msg'}:1: "
    assert "2 custom types in types.paths cannot be used" in rosplc("check", path).output
    assert mistake not in rosplc("check", path).output
    assert rosplc("check", path, "-v").output.count(mistake) == 1
    facts = json.loads(rosplc("check", path, "--json").output)
    assert [each["code"] for each in facts["unusable_types"]] == ["TYP004", "TYP004"]
    listed = rosplc("types", "--path", tmp_path / "ws")
    assert "my_msgs/msg/Good" in listed.stdout and "my_msgs/msg/Wide" not in listed.stdout
    assert listed.stderr.count(f"cannot be used: {mistake}") == 1 and listed.stderr.count("\n") == 1


def test_the_plc_program_finds_its_block_by_the_name_that_is_told(tmp_path: Path) -> None:
    """Instance and type are those of the generated code, also where two topics differ in limits alone."""
    text = (
        "ros: {backend: memory}\ntopics:\n"
        "  /a/type: {type: std_msgs/msg/String, to: plc}\n"
        "  /b: {type: std_msgs/msg/String, to: plc, limits: {data: 5}}\n"
        "  /c: {type: std_msgs/msg/Int32, to: ros, classic: true}\n"
    )
    output = explained(tmp_path, text)
    assert (
        CliRunner().invoke(app, ["generate", str(tmp_path / "rosplc.yaml"), "--out", str(tmp_path)]).exit_code
        == 0
    )
    sources = {file.stem: file.read_text() for file in tmp_path.rglob("*.st")}
    for topic, found in made(text)["topics"].items():
        gvl, _, instance = found["instance"].partition(".")
        assert f"{instance} : {found['block']}(" in sources[gvl], topic
        assert found["block"] in sources
        assert f"with {found['instance']} (block {found['block']})" in output


def test_what_generate_would_refuse_is_a_warning(tmp_path: Path) -> None:
    """Tasks that are one to CODESYS are told before anybody generates."""
    text = (
        "ros: {backend: memory}\ntasks: {Ros: {}, ROS: {}}\ntopics:\n"
        f"  /a: {{type: {INT}, to: plc, task: Ros}}\n  /b: {{type: {INT}, to: plc, task: ROS}}\n"
    )
    assert "Warning: rosplc generate would fail: " in explained(tmp_path, text)
    assert made(text)["topics"]["/a"]["instance"] is None


@pytest.mark.parametrize(
    ("shm", "words"),
    [
        ("{}", "the user who starts the bridge and that user's group, no other user (mode 0660)"),
        ("{group: root}", "the user who starts the bridge and group root, no other user"),
        ("{owner: 0, group: 0}", "user root and group root, no other user"),
        ('{mode: "0600"}', "the user who starts the bridge; that user's group without access, no other user"),
        ('{mode: "0644"}', "that user's group read-only, other users read-only (mode 0644)"),
        ('{mode: "0666"}', "that user's group, other users read-write (mode 0666)"),
    ],
)
def test_who_may_open_the_objects_is_told(tmp_path: Path, shm: str, words: str) -> None:
    """Mode, owner and group in words."""
    assert words in explained(tmp_path, f"ros: {{backend: memory}}\nshm: {shm}\n")


@pytest.mark.parametrize(
    ("entry", "ros", "words"),
    [
        ("to: plc, qos: sensor_data", "jazzy", "are not sent again; at most 5 messages are queued"),
        ("to: plc", "jazzy", "messages from before the bridge started are not received"),
        (
            "to: plc, latched: true",
            "jazzy",
            "messages from before the bridge started are received if their publishers stored them",
        ),
        ("to: ros, qos: {depth: 1}", "jazzy", "sent again; only the newest message is queued"),
        ("to: ros", "jazzy", "a late subscriber gets the stored messages"),
        ("to: ros, latched: false", "jazzy", "a late subscriber gets no earlier messages"),
        ("to: plc", "noetic", "over TCP: nothing is lost while the connection lasts"),
    ],
)
def test_quality_of_service_is_told_in_words(tmp_path: Path, entry: str, ros: str, words: str) -> None:
    """What the settings mean for a message, without the settings' own names."""
    text = f"ros: {{distro: {ros}}}\ntopics:\n  /a: {{type: {INT}, {entry}}}\n"
    assert words in explained(tmp_path, text)


def test_memory_adds_up_and_is_split_by_direction(tmp_path: Path) -> None:
    """The parts of each object, and the totals of both ways."""
    text = (
        f"ros: {{backend: memory}}\ntopics:\n  /a: {{type: {INT}, to: plc}}\n  /b: {{type: {INT}, to: ros}}\n"
    )
    output = explained(tmp_path, text)
    assert "4 slots × 128 = " in output
    assert "Total shared memory: " in output and "(ROS → PLC " in output
    classic = made(f"ros: {{backend: memory}}\ntopics:\n  /a: {{type: {INT}, to: plc, classic: true}}\n")
    assert classic["topics"]["/a"]["memory"]["object_bytes"] == 4


def test_a_large_configuration_is_a_screen(tmp_path: Path) -> None:
    """Without -v at most 24 lines are printed, and the last of the cut table names the option."""
    path = tmp_path / "rosplc.yaml"
    topics = "".join(f"  /topic{n}: {{type: std_msgs/msg/String, to: plc}}\n" for n in range(60))
    path.write_text(f"ros: {{backend: memory}}\ntopics:\n{topics}")
    output = rosplc("check", path).output
    assert len(output.splitlines()) <= 24
    assert "/topic0 " in output and "/topic59" not in output
    assert "rosplc check -v prints every topic" in output
    assert "/topic59" in rosplc("check", "-v", path).output


def test_the_effective_limit_of_each_field_is_printed(tmp_path: Path) -> None:
    """Default, configured and nested capacities are listed with the field's path."""
    path = tmp_path / "rosplc.yaml"
    path.write_text(
        "ros: {backend: memory}\ntopics:\n"
        "  /j: {type: sensor_msgs/msg/JointState, to: plc, limits: {name: 6}}\n"
    )
    assert "header.frame_id 80, name 6, name[] 80, position 16" in rosplc("check", path).output
    assert made(path.read_text())["topics"]["/j"]["limits"]["name"] == 6


def test_another_ros_distribution_in_the_environment_is_a_warning(tmp_path: Path, monkeypatch) -> None:
    """ROS_DISTRO that differs from the configuration is reported, the same one is not."""
    text = "ros: {backend: memory}\ntopics: {/a: {type: std_msgs/msg/Int32, to: plc}}\n"
    monkeypatch.setenv("ROS_DISTRO", "jazzy")
    assert "ROS_DISTRO" not in explained(tmp_path, text)
    monkeypatch.setenv("ROS_DISTRO", "humble")
    assert "ROS_DISTRO is humble, but ros.distro is jazzy" in explained(tmp_path, text)


def test_the_configuration_in_this_folder_is_the_default(tmp_path: Path, monkeypatch) -> None:
    """`check` and `generate` without a file take ./rosplc.yaml."""
    monkeypatch.chdir(tmp_path)
    Path("rosplc.yaml").write_text(
        "ros: {backend: memory}\ntopics: {/a: {type: std_msgs/msg/Int32, to: plc}}\n"
    )
    assert "rosplc.yaml is valid" in rosplc("check").output
    assert "files written" in rosplc("generate").output
    assert Path("plc/rosplc.xml").is_file()


SERVICES = """\
services:
  /grip: {type: std_srvs/srv/Trigger, server: ros, clients: [pick, place], task: Fast}
  /start: {type: std_srvs/srv/SetBool, server: plc, depth: 8, rate_limit: 10ms,
           limits: {response.message: 20}, fallback: {message: down}}
tasks: {Slow: {}, Fast: {}}
"""


def test_services_with_their_clients_limits_and_sizes(tmp_path: Path) -> None:
    path = tmp_path / "rosplc.yaml"
    path.write_text(SERVICES)
    short, long = rosplc("check", path).output, rosplc("check", path, "-v").output
    assert "0 topics and 2 services" in short
    for service, client in (("/grip", "pick"), ("/grip", "place")):
        assert any(
            line.split()[0] == service and client in line.split() for line in short.splitlines() if line
        )
    assert "/start response  message 20" in short
    assert "the caller gets {'success': False, 'message': 'down'}" in long
    assert "service /grip pick  called by the PLC  std_srvs/srv/Trigger" in long
    facts = made(SERVICES)
    pick, _, start = facts["services"]
    assert (pick["server"], pick["client"], pick["task"], pick["depth"]) == ("ros", "pick", "Fast", None)
    assert pick["objects"]["request"]["name"] == "rosplc.sq.grip-pick"
    assert (start["depth"], start["per_client"], start["min_interval_ms"]) == (8, 2, 10.0)
    assert start["objects"]["response"]["limits"] == {"message": 20}
    assert facts["memory_bytes"] == sum(use["memory_bytes"] for use in facts["services"]) > 0


def test_actions_in_words_and_as_json(tmp_path: Path) -> None:
    text = (
        "ros: {backend: memory}\nservices: {/s: {type: std_srvs/srv/Trigger, server: ros}}\nactions:\n"
        "  /a: {type: example_interfaces/action/Fibonacci, server: plc, on_new_goal: buffer, queue: 2}\n"
        "  /b: {type: example_interfaces/action/Fibonacci, server: ros, clients: [x], when_plc_down: keep}\n"
    )
    output = " ".join(explained(tmp_path, text).split())
    for words in (
        "0 topics, 1 service and 2 actions",
        "another goal waits, at most 2",
        "undecided rejected after 5s",
        "without a PLC the goal continues",
        "action /b x called by the PLC",
    ):
        assert words in output
    served, called = made(text)["actions"]
    assert (served["action"], served["queue"], served["accept_within_ms"]) == ("/a", 2, 5000)
    assert list(served["objects"]) == ["goal", "result", "feedback"]
    assert (called["client"], called["when_plc_down"], called["queue"]) == ("x", "keep", None)
