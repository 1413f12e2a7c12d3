"""``rosplc status`` and what keeps ``rosplc top`` from starting."""

from __future__ import annotations

import json
import os
import pty
import subprocess
import sys
import threading
from pathlib import Path
from types import SimpleNamespace

import pytest

from rosplc.cli.options import settled
from rosplc.monitor import State
from rosplc.shm import Direction, Namespace, attach
from tests.channels import Side, layout_of
from tests.command import rosplc
from tests.lib.channels import until

pytestmark = pytest.mark.verifies("views", own="simulation of every state")


@pytest.fixture
def running(shm_namespace):
    """A bridge and a PLC task that beat and exchange messages all the time."""
    side = Side(shm_namespace, "/cell/state", layout_of("std_msgs/msg/Float64"), Direction.TO_PLC)
    attached = attach(shm_namespace, "/cell/state", write=True)
    reader = attached.reader("PLC_PRG", observe=False, beat_ms=100)
    stop, record = threading.Event(), bytearray(8)

    def turn():
        while not stop.wait(0.01):
            side.send(data=1.0)
            reader.latest(record)

    thread = threading.Thread(target=turn)
    thread.start()
    yield shm_namespace.prefix
    stop.set()
    thread.join()
    attached.close()
    side.close()


def test_a_machine_that_is_in_order_is_one_table_and_status_0(running):
    """Bridge, topic, rate and the PLC's life; nothing else."""
    output = rosplc("status", "--prefix", running).output
    assert f"bridge test, prefix {running}, process {os.getpid()}: alive, 1 channel\n" in output
    (row,) = (line.split() for line in output.splitlines() if "/cell/state" in line)
    assert row[:4] == ["ok", "/cell/state", "→", "PLC"]
    assert row[-1] == "alive"


def test_json_is_the_picture(running):
    """The same for programs, with everything that is known."""
    document = json.loads(rosplc("status", "--prefix", running, "--json").output)
    (channel,) = document["channels"]
    assert (channel["state"], channel["level"], channel["severity"]) == ("ok", "OK", 0)
    assert channel["rate_hz"] > 0
    assert channel["readers"][0]["task"] == "PLC_PRG"
    assert document["worst"] == "ok"
    assert document["bridges"][0]["alive"] is True


def test_what_is_wrong_is_said_in_words_and_ends_with_status_1(shm_namespace, monkeypatch):
    """A dead bridge, a topic that is missing, an object that is none."""
    monkeypatch.setattr("rosplc.monitor.tracked.is_starting", lambda pid: False)  # this process may be young
    side = Side(shm_namespace, "/n", layout_of("std_msgs/msg/Float64"), Direction.TO_PLC)
    shm_namespace.path("/broken").write_bytes(b"\x1b" * 600)
    output = rosplc("status", "--prefix", shm_namespace.prefix, code=1).output
    side.close()
    assert f"/n: dead: the heartbeat of the bridge (process {os.getpid()}) has stopped" in output
    assert "/broken: unreadable: " in output
    assert "[SHM104]" in output
    assert "\x1b" not in output


def test_it_looks_until_it_knows_of_the_bridge():
    """A PLC that is missing is known at once, a bridge that does not beat only after a while."""
    beats = iter([None, None, False])

    def look():
        view = SimpleNamespace(state=State.NO_PLC, bridge_alive=next(beats), readers=())
        return SimpleNamespace(channels=[view])

    picture = settled(SimpleNamespace(look=look), least=0.0, most=10**6)
    assert picture.channels[0].bridge_alive is False


def test_a_configuration_says_what_is_missing(tmp_path, shm_namespace):
    """Each of its topics without a channel is a line."""
    config = tmp_path / "rosplc.yaml"
    config.write_text(
        f"bridge: cell1\nprefix: {shm_namespace.prefix}\n"
        "topics:\n  /a: {type: std_msgs/msg/Bool, to: plc}\n"
        f"  /b: {{type: std_msgs/msg/Bool, to: ros, classic: {{name: {shm_namespace.prefix}_b}}}}\n"
    )
    output = rosplc("status", "--config", config, "--prefix", shm_namespace.prefix, code=1).output
    assert "/a: missing: " in output
    assert "/b: missing: this memory does not exist" in output


def test_a_configuration_means_its_bridge_only(running, tmp_path, shm_namespace):
    """What another bridge does is no trouble of this one's."""
    config = tmp_path / "rosplc.yaml"
    config.write_text(
        f"bridge: test\nprefix: {running}\ntopics: {{/cell/state: {{type: std_msgs/msg/Float64, to: plc}}}}\n"
    )
    other = Side(
        Namespace(f"{running}x", shm_namespace.directory),
        "/n",
        layout_of("std_msgs/msg/Float64"),
        Direction.TO_PLC,
    )
    try:
        document = json.loads(rosplc("status", "--config", config, "--json").output)
    finally:
        other.channel.retire()
    assert {channel["prefix"] for channel in document["channels"]} == {running}


def test_a_configuration_in_this_folder_is_the_default(running, tmp_path, shm_namespace, monkeypatch):
    """The verbs that look use ./rosplc.yaml, unless a file or a prefix is named."""
    monkeypatch.chdir(tmp_path)
    topics = "topics: {/cell/state: {type: std_msgs/msg/Float64, to: plc}}\n"
    Path("rosplc.yaml").write_text(f"bridge: test\nprefix: {running}\n{topics}")
    other = Side(
        Namespace(f"{running}x", shm_namespace.directory),
        "/n",
        layout_of("std_msgs/msg/Float64"),
        Direction.TO_PLC,
    )

    def prefixes(*asked, code=0):
        document = json.loads(rosplc("status", "--json", *asked, code=code).output)
        return {channel["prefix"] for channel in document["channels"]}

    try:
        assert prefixes() == {running}
        assert prefixes("--prefix", f"{running}x", code=1) == {f"{running}x"}
        assert "/cell/state" in rosplc("show", "/cell/state").output
        recorded = json.loads(rosplc("record", "-o", "r", "--duration", "500ms", "--json").stdout)
        assert list(recorded["topics"]) == ["/cell/state"]
        Path("rosplc.yaml").write_text(f"bridge: test\nprefix: {running}y\n{topics}")
        assert prefixes(code=1) == {f"{running}y"}  # configured and missing
        Path("rosplc.yaml").write_text(f"bridge: test\nprefix: {running}y\ntopics: {{}}\n")
        assert f"no channel with the prefix {running}y on this machine" in rosplc("status", code=1).output
    finally:
        other.channel.retire()


def test_show_has_age_and_state_and_marks_what_is_dead(running, shm_namespace):
    """One topic's message comes with its state; a reader without a beat is shown as dead."""
    output = rosplc("show", "/cell/state", "--prefix", running, "--header").output
    assert "  ok, " in output and " old" in output and ", dead" not in output
    document = json.loads(rosplc("show", "/cell/state", "--prefix", running, "--json").output)
    assert document["state"] == "ok" and document["age_ns"] >= 0
    side = Side(shm_namespace, "/n", layout_of("std_msgs/msg/Float64"), Direction.TO_PLC)
    with attach(shm_namespace, "/n", write=True) as plc:
        plc.reader("PLC_PRG", observe=False, beat_ms=10)
        output = rosplc("show", "/n", "--prefix", shm_namespace.prefix, "--header").output
    side.close()
    assert "lost 0, dead" in output


def test_show_of_unreadable_objects_alone_ends_with_status_1(shm_namespace):
    """A list of errors is no list of channels."""
    shm_namespace.path("/broken").write_bytes(b"x" * 600)
    assert "SHM104" in rosplc("show", "--prefix", shm_namespace.prefix, code=1).output


def test_a_machine_without_channels_ends_with_status_1(shm_namespace, tmp_path):
    """Nothing to be seen is nothing to rely on."""
    for asked in ((), ("--prefix", shm_namespace.prefix)):
        output = rosplc("status", *asked, "--directory", tmp_path, code=1).output
        assert "There are no channels on this machine" in output


def test_a_prefix_without_channels_is_told_from_a_machine_without_any(running):
    """Where others have channels, they are named; in JSON nothing is not called ok."""
    for verb in ("status", "show"):
        code = 1 if verb == "status" else 0
        output = rosplc(verb, "--prefix", "nosuch", code=code).output
        none = "There is no channel with the prefix nosuch on this machine"
        assert f"{none}; existing prefixes: " in output
        assert "There are no channels" not in output
    document = json.loads(rosplc("status", "--prefix", "nosuch", "--json", code=1).output)
    assert (document["worst"], document["channels"]) == (None, [])


@pytest.mark.parametrize("given", ["soon", "5", "-1s"])
def test_a_wrong_duration_is_refused(given):
    """Status 2, and the text says what would be right."""
    output = rosplc("status", f"--stale-after={given}", code=2).output
    assert "never" in output


def test_following_prints_what_happens(running, shm_namespace):
    """After the table, one JSON document per event."""
    child = subprocess.Popen(
        [sys.executable, "-m", "rosplc", "status", "--prefix", running, "--follow", "--json"],
        stdout=subprocess.PIPE,
        text=True,
    )
    try:
        assert json.loads(child.stdout.readline())["channels"]
        other = Side(shm_namespace, "/new", layout_of("std_msgs/msg/Bool"), Direction.TO_PLC)
        event = json.loads(until(child, "{"))
        other.close()
        assert (event["kind"], event["topic"]) == ("appeared", "/new")
    finally:
        child.kill()
        child.communicate()


def test_top_refuses_what_is_no_terminal():
    """SYS012 names the stream, and what to use instead."""
    done = subprocess.run(
        [sys.executable, "-m", "rosplc", "top"], stdin=subprocess.DEVNULL, capture_output=True, text=True
    )
    assert done.returncode == 1
    assert "error SYS012: stdin is not a terminal" in done.stderr
    assert "rosplc status" in done.stderr


def test_top_refuses_a_terminal_that_only_prints_lines():
    """TERM=dumb is said, not filled with control sequences."""
    pid, terminal = pty.fork()
    if pid == 0:
        os.execve(sys.executable, [sys.executable, "-m", "rosplc", "top"], {**os.environ, "TERM": "dumb"})
    output = b""
    while chunk := _read(terminal):
        output += chunk
    assert os.waitstatus_to_exitcode(os.waitpid(pid, 0)[1]) == 1
    assert b"TERM=dumb" in output
    assert b"\x1b" not in output


def _read(terminal):
    try:
        return os.read(terminal, 4096)
    except OSError:  # what a terminal says at its end
        return b""


def test_top_names_the_package_that_is_missing(monkeypatch):
    """Without textual there is a pip command, and no traceback."""
    monkeypatch.setitem(sys.modules, "textual", None)
    result = rosplc("top", code=1)
    assert "pip install " in result.output and "[views]" in result.output
