"""``rosplc init`` as it is used: on a live graph, on a terminal, from a recording, and with nobody there."""

from __future__ import annotations

import json
import os
import pty
import select
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import pytest
from typer.testing import CliRunner

from rosplc.cli.app import app
from rosplc.config import load_project
from rosplc.demo.plan import FreeDomain
from rosplc.project import check
from rosplc.ros import SERVICES, open_backend
from tests.unit.init.robots import PART, PART_TEXTS, STORE, Robot, record

MEMORY = ("--backend", "memory", "--listen", "2s")
_domains = iter(range(1, 233))


@pytest.fixture(autouse=True)
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """An empty folder, and an environment that names no ROS."""
    monkeypatch.chdir(tmp_path)
    for name in ("ROS_DISTRO", "ROS_MASTER_URI", "ROS_DOMAIN_ID", "RMW_IMPLEMENTATION", "AMENT_PREFIX_PATH"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    return tmp_path


@pytest.fixture
def memory(monkeypatch: pytest.MonkeyPatch) -> Iterator[tuple[str, ...]]:
    """A robot in this process, and the options that lead to it."""
    # No other node comes into a graph of this process.
    monkeypatch.setattr("rosplc.ros.backend._STEADY_NS", 100_000_000)
    domain = next(_domains)
    with Robot("memory", domain):
        yield (*MEMORY, "--domain", str(domain))


def rosplc(*arguments: object, code: int = 0):
    result = CliRunner().invoke(app, ["init", *map(str, arguments)], terminal_width=200)
    assert result.exit_code == code, result.output
    assert "Traceback" not in result.output
    return result


def test_everything_is_written_checked_and_explained(memory: tuple[str, ...], here: Path) -> None:
    """--all writes a file that loads without a warning, names what is left out, and says what comes next."""
    output = rosplc("--all", *memory).output
    project = load_project(here / "rosplc.yaml")
    assert {plan.topic: int(plan.direction) for plan in project.topics} == {
        "/cmd_vel": 2,
        "/joint_states": 1,
        "/mode": 1,
    }
    plan = project.topic("/joint_states")
    assert (plan.qos.reliability, plan.layout.limits.fields["name"]) == ("best_effort", 6)
    assert project.topic("/mode").latched
    assert check(project)["warnings"] == []
    assert f"Left out /parts: {PART} is unknown" in output
    assert "--types" in output
    for words in ("rosplc check rosplc.yaml", "rosplc run rosplc.yaml", "rosplc generate rosplc.yaml"):
        assert words in output


def test_services_and_actions_are_proposed_when_asked_for(memory: tuple[str, ...], here: Path) -> None:
    """They are comments; without their marks the file loads. A node's own services are left out."""
    robot = open_backend("memory", STORE, "arm", domain=int(memory[-1]))
    kept = [robot.serve("/grip", "std_srvs/srv/Trigger", SERVICES, lambda *_: None)]
    kept.append(
        robot.serve("/arm/get_parameters", "rcl_interfaces/srv/GetParameters", SERVICES, lambda *_: None)
    )
    kept.append(robot.client("/start", "std_srvs/srv/SetBool", SERVICES))
    goal = "tf2_msgs/action/LookupTransform_SendGoal"
    kept.append(robot.serve("/look/_action/send_goal", goal, SERVICES, lambda *_: None))
    try:
        rosplc("--topics", "/mode", *memory)
        assert "/grip" not in (here / "rosplc.yaml").read_text()
        rosplc("--topics", "/mode", "--services", "--force", *memory)
    finally:
        robot.close()
    text = (here / "rosplc.yaml").read_text()
    assert not load_project(here / "rosplc.yaml").calls
    assert "get_parameters" not in text
    lines = text.splitlines()
    marked = lines.index("#services:")
    (here / "all.yaml").write_text("\n".join([*lines[:marked], *(line[1:] for line in lines[marked:])]))
    project = load_project(here / "all.yaml")
    assert {(plan.kind, plan.called, plan.server) for plan in project.calls} == {
        ("service", "/grip", "ros"),
        ("service", "/start", "plc"),
        ("action", "/look", "ros"),
    }


def test_what_is_there_is_never_overwritten(memory: tuple[str, ...], here: Path) -> None:
    """A file, even a broken link, stops it before it looks; --force replaces it."""
    path = here / "rosplc.yaml"
    path.write_text("mine")
    assert "CFG013" in rosplc("--all", *memory, code=2).stderr
    assert path.read_text() == "mine"
    (here / "link.yaml").symlink_to(here / "elsewhere.yaml")
    assert "CFG013" in rosplc("--all", "-o", "link.yaml", *memory, code=2).stderr
    rosplc("--all", "--force", *memory)
    assert load_project(path).topics
    names = sorted(each.name for each in here.iterdir())
    assert names == [".rosplc.schema.json", "link.yaml", "rosplc.yaml"]
    assert path.read_text().startswith("# yaml-language-server: $schema=.rosplc.schema.json\n")


def test_places_that_cannot_be_written_are_said_before_it_looks(here: Path) -> None:
    """A folder in the way, or none to write into, is an error at once."""
    (here / "folder").mkdir()
    assert "CFG014" in rosplc("--all", "-o", "nowhere/rosplc.yaml", code=2).stderr
    assert "CFG014" in rosplc("--all", "--force", "-o", "folder", code=2).stderr


def test_custom_types_come_from_a_folder_of_the_user_or_an_installed_ros(
    memory: tuple[str, ...], here: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """--types is named in types.paths as it is; what a sourced ROS has is copied beside the file."""
    first, second = PART_TEXTS.split(f"{'=' * 80}\nMSG: cell_msgs/Side\n")
    for root in ("mine/cell_msgs/msg", "ros/share/cell_msgs/msg"):
        (here / root).mkdir(parents=True)
        (here / root / "Part.msg").write_text(first)
        (here / root / "Side.msg").write_text(second)
    rosplc("--topics", "/parts", "--types", "mine", *memory)
    assert load_project(here / "rosplc.yaml").config.settings.types.paths == ("mine",)
    monkeypatch.setenv("AMENT_PREFIX_PATH", f"{here}/nothing:{here}/ros")
    output = rosplc("--topics", "/parts", "-o", "two.yaml", *memory).output
    assert load_project(here / "two.yaml").config.settings.types.paths == ("msg",)
    assert (here / "msg/cell_msgs/msg/Side.msg").read_text() == second
    assert f"Saved: {PART}, from {here}/ros/share/cell_msgs/msg/Part.msg" in output


def test_custom_types_come_from_a_node_that_describes_them(
    here: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """They are saved beside the file, and the output says where they come from."""
    monkeypatch.setattr("rosplc.ros.backend._STEADY_NS", 100_000_000)
    domain = next(_domains)
    with Robot("memory", domain, describes=True):
        output = rosplc("--topics", "/parts", *MEMORY, "--domain", domain).output
    assert load_project(here / "rosplc.yaml").config.settings.types.paths == ("msg",)
    assert f"Saved: {PART}, from node /robot\n" in output


def test_json_has_everything_and_asks_nothing(memory: tuple[str, ...], here: Path) -> None:
    """What was found, what was seen, what was written; stderr stays empty."""
    result = rosplc("--json", "--yes", *memory)
    assert result.stderr == ""
    document = json.loads(result.stdout)
    assert document["found"]["/cmd_vel"] == {
        "types": ["geometry_msgs/msg/Twist"],
        "publishers": [],
        "subscribers": ["/robot"],
    }
    joints = document["topics"]["/joint_states"]
    assert joints["limits"]["name"] == 6
    assert joints["seen"]["messages"] > 0
    assert document["left_out"].keys() == {"/parts"}
    assert document["configuration"] == (here / "rosplc.yaml").read_text()


def test_without_a_choice_the_topics_are_listed(memory: tuple[str, ...], here: Path) -> None:
    """Without a terminal and without a choice, status 2, the list, and nothing written."""
    result = rosplc(*memory, code=2)
    assert "4 topics in domain" in result.stdout
    assert "--all" in result.stderr
    assert list(here.iterdir()) == []


@pytest.mark.parametrize(
    ("arguments", "code", "words"),
    [
        (["--all"], 1, "ROS020"),
        (["--all", "--backend", "nonsense"], 2, "'nonsense' is not a backend"),
        (["--all", "--distro", "nonsense"], 2, "is not a bundled distribution"),
        (["--all", "--listen", "soon"], 2, "should be a number with a unit"),
        (["--topics", "/a=b"], 2, "is not a type name"),
        (["--bag", "missing.bag", "--all"], 1, "ROS006"),
        (["--types", "missing", "--all"], 1, "TYP008"),
        (["--bridge", "a b", "--all"], 2, "should be a letter"),
    ],
)
def test_what_is_wrong_is_said(arguments: list[str], code: int, words: str, here: Path) -> None:
    """Each mistake has its words, and nothing is written."""
    arguments = [*arguments, "--look", "300ms"]
    backend = [] if "--backend" in arguments else ["--backend", "memory", "--domain", str(next(_domains))]
    assert words in " ".join(rosplc(*arguments, *backend, code=code).stderr.split())
    assert list(here.iterdir()) == []


def test_recording_is_enough(here: Path) -> None:
    """--bag needs no robot; the types of the recording are saved."""
    record(here / "line3")
    output = rosplc("--bag", "line3", "--all", "--to-ros", "/plc/done=std_msgs/UInt32").output
    project = load_project(here / "rosplc.yaml")
    assert [plan.topic for plan in project.topics] == ["/joint_states", "/parts", "/plc/done"]
    assert f"Saved: {PART}, from the recording line3" in output


@pytest.fixture
def domain() -> Iterator[int]:
    free = FreeDomain()
    yield free.number
    free.close()


def start(domain: int, *arguments: str, stream: int | None = None) -> subprocess.Popen[bytes]:
    environment = {**os.environ, "ROS_DOMAIN_ID": str(domain)}
    return subprocess.Popen(
        [sys.executable, "-m", "rosplc", "init", *arguments],
        env=environment,
        stdin=subprocess.DEVNULL if stream is None else stream,
        stdout=subprocess.PIPE if stream is None else stream,
        stderr=subprocess.PIPE if stream is None else stream,
        start_new_session=stream is not None,
    )


def read_until(stream: int, words: str) -> str:
    """Read a terminal until it shows the words; a watchdog ends what never does."""
    text, deadline = "", time.monotonic() + 90
    while words not in text:
        assert time.monotonic() < deadline, text
        if select.select([stream], [], [], 1.0)[0]:
            text += os.read(stream, 65536).decode("utf-8", "replace")
    return text


@pytest.mark.foreign
def test_questions_on_a_terminal(domain: int, here: Path) -> None:
    """Over DDS, in front of a terminal: the list, which topics, which way, and the file."""
    with Robot("dds", domain):
        ours, theirs = pty.openpty()
        process = start(domain, "--look", "60s", "--listen", "500ms", stream=theirs)
        os.close(theirs)
        try:
            shown = read_until(ours, "Topics to carry")
            assert "/joint_states" in shown
            os.write(ours, b"nonsense\n")
            read_until(ours, "Topics to carry")
            os.write(ours, b"1-2, /mode\n")
            read_until(ours, "Carry it to (plc/ros/none) [ros]")
            os.write(ours, b"\n")
            read_until(ours, "[plc]")
            os.write(ours, b"p\n")
            read_until(ours, "[plc]")
            os.write(ours, b"none\n")
            read_until(ours, "Next:")
            assert process.wait(60) == 0
        finally:
            process.kill()
            process.wait()
            os.close(ours)
    project = load_project(here / "rosplc.yaml")
    assert {plan.topic for plan in project.topics} == {"/cmd_vel", "/joint_states"}
    assert project.config.settings.ros.domain == domain


@pytest.mark.foreign
def test_interrupt_writes_nothing(domain: int, here: Path) -> None:
    """Ctrl-C while it listens ends it with status 130 and says that nothing was written."""
    with Robot("dds", domain):
        process = start(domain, "--topics", "/joint_states", "--look", "60s", "--listen", "10min")
        assert process.stderr is not None
        text = b""
        while b"Listening" not in text:
            line = process.stderr.readline()
            assert line, text
            text += line
        process.send_signal(signal.SIGINT)
        _, rest = process.communicate(timeout=90)
    assert process.returncode == 130
    assert b"no configuration was written" in rest
    assert list(here.iterdir()) == []
