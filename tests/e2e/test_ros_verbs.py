"""``rosplc pub``, ``list``, ``echo`` and ``hz`` as processes on one DDS domain."""

from __future__ import annotations

import json
import os
import re
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import IO

import pytest

from rosplc.model import TypeStore
from rosplc.ros import SERVICES, ActionServer, open_backend
from tests.interop.graphs import LOCAL
from tests.lib.waiting import wait_for

pytestmark = pytest.mark.timeout(300)
TWIST = ("/cmd_vel", "geometry_msgs/msg/Twist", "{linear: {x: 0.5}}")


class Command:
    """The command on the test's domain."""

    def __init__(self, domain: int, folder: Path) -> None:
        self.folder = folder
        self.env = {**os.environ, **LOCAL, "ROS_DOMAIN_ID": str(domain)}

    def start(self, *words: str, stdout: int | IO[str] = subprocess.PIPE) -> subprocess.Popen[str]:
        """Start it and go on."""
        command = [sys.executable, "-m", "rosplc", *words]
        return subprocess.Popen(command, cwd=self.folder, env=self.env, stdout=stdout, text=True)

    def run(self, *words: str) -> str:
        """Run it to its end and return what it printed."""
        process = self.start(*words)
        output, _ = process.communicate()
        assert process.returncode == 0, output
        return output


@pytest.fixture
def command(dds_domain: int, tmp_path: Path) -> Command:
    """Give the command."""
    return Command(dds_domain, tmp_path)


@pytest.fixture
def published(command: Command) -> Iterator[None]:
    """Have a Twist published twenty times a second."""
    printed = command.folder / "pub.txt"
    with printed.open("w") as file:
        process = command.start("pub", "-r", "20", *TWIST, stdout=file)
    wait_for(lambda: "publishing #1: geometry_msgs.msg.Twist(" in printed.read_text(), "the first message")
    yield
    process.send_signal(signal.SIGINT)
    process.communicate()
    assert process.returncode == 130


@pytest.mark.foreign
@pytest.mark.usefixtures("published")
def test_a_published_topic_is_listed_echoed_and_timed(command: Command) -> None:
    """The type is taken from the graph."""
    assert "/cmd_vel [geometry_msgs/msg/Twist]" in command.run("list", "--show-types").splitlines()
    assert json.loads(command.run("list", "--json"))["/cmd_vel"] == ["geometry_msgs/msg/Twist"]
    assert command.run("echo", "/cmd_vel", "--once").startswith("linear:\n  x: 0.5\n  y: 0.0\n")
    assert command.run("echo", "/cmd_vel", "--once", "--field", "linear.x", "--json") == "0.5\n"
    timed = command.start("hz", "/cmd_vel")
    assert timed.stdout is not None
    rate = re.fullmatch(r"average rate: ([\d.]+)\n", timed.stdout.readline())
    timed.send_signal(signal.SIGINT)
    timed.communicate()
    assert rate is not None
    assert float(rate[1]) > 0


def test_services_and_actions_are_listed(
    command: Command, dds_domain: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Each by its own name and type: those that an action consists of are none of the services."""
    for name, value in LOCAL.items():
        monkeypatch.setenv(name, value)
    store, fibonacci = TypeStore.bundled("jazzy"), "example_interfaces/action/Fibonacci"
    node = open_backend("dds", store, "robot", domain=dds_domain)
    node.serve("/arm/home", "std_srvs/srv/Trigger", SERVICES, lambda *_: None)
    action = ActionServer(
        node, store, "/arm/move", fibonacci, on_goal=lambda *_: None, on_cancel=lambda _: None
    )
    try:
        expected = {"/arm/move": [fibonacci]}
        wait_for(lambda: json.loads(command.run("list", "--actions", "--json")) == expected, "the action")
        expected = {"/arm/home": ["std_srvs/srv/Trigger"]}
        wait_for(lambda: json.loads(command.run("list", "--services", "--json")) == expected, "the service")
    finally:
        action.close()
        node.close()


def test_one_message_waits_for_its_subscriber(command: Command) -> None:
    """A type of the user's own comes from the folder that the configuration here names."""
    folder = command.folder / "msg" / "cell_msgs" / "msg"
    folder.mkdir(parents=True)
    (folder / "Part.msg").write_text("uint32 number\nstring label\n")
    (command.folder / "rosplc.yaml").write_text(
        "bridge: cell\nros: {backend: dds, distro: jazzy}\ntypes: {paths: [msg]}\ntopics: {}\n"
    )
    echo = command.start("echo", "/part", "cell_msgs/msg/Part", "--once")
    command.run("pub", "--once", "/part", "cell_msgs/msg/Part", "{number: 7, label: door handle}")
    output, _ = echo.communicate()
    assert output == "number: 7\nlabel: door handle\n---\n"


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("pub", "/x", "geometry_msgs/msg/Twist", "{linar: {x: 1}}", "--once"), "linar"),
        (("pub", "/x", "geometry_msgs/msg/Twist", "{", "--once"), "not valid YAML"),
        (("pub", "/x", "geometry_msgs/msg/Twits", "--once"), "Twits"),
    ],
)
def test_what_is_wrong_is_said(command: Command, words: tuple[str, ...], said: str) -> None:
    """Before anything is published."""
    process = subprocess.run(
        [sys.executable, "-m", "rosplc", *words],
        cwd=command.folder,
        env=command.env,
        capture_output=True,
        text=True,
    )
    assert process.returncode in (1, 2)
    assert said in process.stderr
    assert "Traceback" not in process.stderr
