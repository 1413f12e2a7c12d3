"""``rosplc reload``, ``rosplc clean``, ``rosplc explain``, and a terminal that is closed under a bridge."""

from __future__ import annotations

import json
import os
import pty
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from rosplc.errors import CODES, ChannelError
from rosplc.shm import Direction, Namespace, OwnedChannel, Part, attach
from tests.channels import STORE
from tests.command import rosplc
from tests.lib.channels import open_service
from tests.lib.waiting import wait_for

INT = "std_msgs/msg/Int32"


@pytest.fixture
def config(tmp_path: Path, shm_namespace: Namespace) -> Path:
    path = tmp_path / "rosplc.yaml"
    topics = f"topics:\n  /a: {{type: {INT}, to: plc}}\n"
    path.write_text(f"prefix: {shm_namespace.prefix}\nros: {{backend: memory}}\n{topics}")
    return path


@pytest.fixture
def bridge(
    config: Path, shm_namespace: Namespace, tmp_path: Path
) -> Iterator[Callable[..., subprocess.Popen]]:
    """Start ``rosplc run`` with its log in a file, and wait until it carries."""
    started: list[subprocess.Popen] = []

    def start(**options: object) -> subprocess.Popen:
        with (tmp_path / "log").open("w") as log:
            options.setdefault("start_new_session", True)
            command = [sys.executable, "-m", "rosplc", "run", str(config)]
            child = subprocess.Popen(command, stderr=log, stdout=log, **options)
        started.append(child)
        wait_for(lambda: "carries" in (tmp_path / "log").read_text(), "the bridge starts")
        return child

    yield start
    for child in started:
        child.kill()
        child.wait()


def test_reload_applies_the_changed_file(bridge, config, shm_namespace, tmp_path) -> None:
    """The bridge of the configuration gets the new topic, and the command names its process."""
    child = bridge()
    config.write_text(config.read_text() + f"  /b: {{type: {INT}, to: plc}}\n")
    assert str(child.pid) in rosplc("reload", config).output
    wait_for(lambda: shm_namespace.path("/b").exists(), "the topic is carried")
    config.write_text("topics: [")
    assert "CFG002" in rosplc("reload", config, code=2).stderr
    assert child.poll() is None


def test_reload_without_a_bridge_is_an_error(config) -> None:
    """Nothing is signalled where nothing holds the prefix."""
    assert "no bridge with the prefix" in rosplc("reload", config, code=1).stderr


@pytest.mark.foreign
def test_reload_leaves_a_program_alone_that_has_bound_a_topic(shm_namespace) -> None:
    """It holds a name as a bridge does, but SIGUSR1 would end it."""
    bound = f"rosplc.bind('/a', {INT!r}, prefix={shm_namespace.prefix!r})"
    code = f"import rosplc, sys; topic = {bound}; print('bound', flush=True); sys.stdin.read()"
    with subprocess.Popen(
        [sys.executable, "-c", code], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    ) as child:
        assert child.stdout is not None and child.stdout.readline() == "bound\n"
        assert "no bridge" in rosplc("reload", "--prefix", shm_namespace.prefix, code=1).stderr
        assert child.poll() is None
        child.communicate()
    assert child.returncode == 0


@pytest.mark.foreign
def test_a_closed_terminal_ends_the_bridge(config, shm_namespace, tmp_path) -> None:
    """On a terminal SIGHUP is its end, and the claims are given back."""
    pid, terminal = pty.fork()
    if pid == 0:  # pragma: no cover - the child
        os.execv(sys.executable, [sys.executable, "-m", "rosplc", "run", str(config)])
    output = b""
    while b"carries" not in output:
        output += os.read(terminal, 4096)
    os.close(terminal)
    wait_for(lambda: os.waitpid(pid, os.WNOHANG)[0] == pid, "the bridge ends with its terminal")
    assert rosplc("clean", "--prefix", shm_namespace.prefix, "--dry-run").output.count("would remove") == 2


def test_without_a_terminal_sighup_reloads(bridge, config, shm_namespace) -> None:
    """As a service manager expects."""
    child = bridge()
    config.write_text(config.read_text() + f"  /b: {{type: {INT}, to: plc}}\n")
    child.send_signal(signal.SIGHUP)
    wait_for(lambda: shm_namespace.path("/b").exists(), "the topic is carried")


@pytest.mark.foreign
def test_an_ignored_interrupt_is_heeded(bridge) -> None:
    """A shell script ignores SIGINT for what it starts with &; kill -INT ends the bridge anyway."""
    child = bridge(preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_IGN))
    child.send_signal(signal.SIGINT)
    assert child.wait(60) == 0


def test_clean_removes_what_nobody_holds_and_nothing_else(shm_namespace, tmp_path) -> None:
    """A held channel, a foreign file and other prefixes stay; a removed object is retired first."""
    from rosplc.described import description_of
    from rosplc.layout import Limits, compute_layout
    from rosplc.shm import attach

    layout = compute_layout(STORE, INT, Limits())

    def owned(topic: str) -> OwnedChannel:
        description = description_of(layout, topic, Direction.TO_PLC, bridge="cell")
        return OwnedChannel.open(shm_namespace, description, record_size=layout.size, slots=4)

    left = owned("/left")
    left.close()
    foreign = shm_namespace.path("/foreign")
    foreign.write_text("something else")
    temporary = foreign.with_name(f"{shm_namespace.prefix}.n.left.0123abcd")
    temporary.write_text("")
    attached = attach(shm_namespace, "/left")
    with owned("/held"):
        output = rosplc("clean", "--prefix", shm_namespace.prefix).output
        assert shm_namespace.path("/held").exists()
    assert not shm_namespace.path("/left").exists() and not temporary.exists()
    assert foreign.read_text() == "something else"
    assert ("SHM116" in output and "SHM104" in output) or "SHM103" in output
    assert not attached.still_there()
    attached.close()
    foreign.unlink()


def test_show_and_clean_know_the_objects_of_services(shm_namespace) -> None:
    """Both are listed with part and client; what nobody holds is removed with its lock."""
    held, left = open_service(shm_namespace), open_service(shm_namespace, "ros", client="left")
    for channel in left:
        channel.close()
    prefix = shm_namespace.prefix
    listed = json.loads(rosplc("show", "--prefix", prefix, "--json").output)
    assert [(one["topic"], one["part"], one["client"], one["direction"]) for one in listed] == [
        ("/add", "request", "", "to_plc"),
        ("/add", "request", "left", "to_ros"),
        ("/add", "response", "", "to_ros"),
        ("/add", "response", "left", "to_plc"),
    ]
    output = rosplc("show", "--prefix", prefix).output
    assert "/add" in output and "response" in output and "left" in output
    shm_namespace.path("/add", Part.GOAL).write_text("something else")
    assert "SHM103" in rosplc("show", "--prefix", prefix).output
    temporary = shm_namespace.temporary_prefix("/add", Part.REQUEST, "left") + "0123abcd"
    shm_namespace.path("/add").with_name(temporary).write_text("")
    rosplc("clean", "--prefix", prefix, "--topic", "/other")
    assert len(shm_namespace.objects()) == 5
    for channel in left:
        assert channel.path.exists()
    with attach(shm_namespace, "/add", part=Part.REQUEST, client="left") as attached:
        output = rosplc("clean", "--prefix", prefix, "--topic", "/add").output
        with pytest.raises(ChannelError, match="SHM111"):
            attached.valid()
    assert output.count("removed") == 5 and output.count("SHM116") == 2 and "SHM103" in output
    shm_namespace.path("/add", Part.GOAL).unlink()
    assert [name for name, _ in shm_namespace.objects()] == [channel.path.name for channel in held]
    for channel in held:
        channel.close()
    rosplc("clean", "--prefix", prefix)
    assert list(held[0].path.parent.glob(f"{prefix}.*")) == []


@pytest.mark.parametrize(
    ("given", "words"),
    [
        ("SHM112", "SHM112: layout differs"),
        ("112", "SHM112"),
        ("doc603", "meaning: "),
        ("CFG001", "remedy: "),
    ],
)
def test_a_code_is_explained(given, words) -> None:
    """Errors, findings and the numbers of PLC blocks, without the documentation at hand."""
    assert words in rosplc("explain", given).output


def test_an_unknown_code_gets_the_nearest(tmp_path) -> None:
    """A misspelt code is an error of the command line; no code at all lists every one."""
    assert "did you mean SHM1" in " ".join(rosplc("explain", "SHM1O1", code=2).stderr.split())
    assert all(code in rosplc("explain").output for code in CODES)
