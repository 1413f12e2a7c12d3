"""What ``rosplc check`` tells a technician and an integrator."""

from __future__ import annotations

from pathlib import Path

import pytest
from typer.testing import CliRunner

from rosplc.cli.app import app
from rosplc.cli.check_facts import facts
from rosplc.config import parse_config, resolve

INT = "std_msgs/msg/Int32"


def explained(folder: Path, text: str) -> str:
    path = folder / "rosplc.yaml"
    path.write_text(text)
    result = CliRunner().invoke(app, ["check", str(path)])
    assert result.exit_code == 0, result.output
    return result.output


def made(text: str):
    return facts(resolve(parse_config(text)))


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
    assert "Warning: rosplc generate would refuse this" in explained(tmp_path, text)
    assert made(text)["topics"]["/a"]["instance"] is None


@pytest.mark.parametrize(
    ("shm", "words"),
    [
        ("{}", "the user who starts the bridge and that user's group, nobody else (mode 0660)"),
        ("{group: root}", "the user who starts the bridge and group root, nobody else"),
        ("{owner: 0, group: 0}", "user root and group root, nobody else"),
        ('{mode: "0600"}', "the user who starts the bridge; that user's group not at all, nobody else"),
        ('{mode: "0644"}', "that user's group reading only, everybody else reading only (mode 0644)"),
        ('{mode: "0666"}', "that user's group, everybody else reading and writing (mode 0666)"),
    ],
)
def test_who_may_open_the_objects_is_told(tmp_path: Path, shm: str, words: str) -> None:
    """Mode, owner and group in words."""
    assert words in explained(tmp_path, f"ros: {{backend: memory}}\nshm: {shm}\n")


@pytest.mark.parametrize(
    ("entry", "ros", "words"),
    [
        ("to: plc, qos: sensor_data", "jazzy", "what is lost on the way stays lost; at most 5 messages wait"),
        ("to: plc", "jazzy", "what was published before the start of the bridge does not come"),
        (
            "to: plc, latched: true",
            "jazzy",
            "what publishers kept from before the start of the bridge comes, too",
        ),
        ("to: ros, qos: {depth: 1}", "jazzy", "sent again; one message waits, the newest"),
        ("to: ros", "jazzy", "who subscribes later gets the messages that were kept"),
        ("to: ros, latched: false", "jazzy", "who subscribes later gets nothing from before"),
        ("to: plc", "noetic", "over TCP: nothing is lost on the way while the connection stands"),
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
    assert "Shared memory in all: " in output and "towards the PLC, " in output
    classic = made(f"ros: {{backend: memory}}\ntopics:\n  /a: {{type: {INT}, to: plc, classic: true}}\n")
    assert classic["topics"]["/a"]["memory"]["object_bytes"] == 4
