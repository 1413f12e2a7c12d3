"""`rosplc record` and `rosplc replay` as they are typed: files, JSON, signals, and what is refused."""

from __future__ import annotations

import json
import os
import pty
import signal
import subprocess
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from rosplc.recorder.mcap_file import survey
from rosplc.shm import Namespace, attach
from tests.command import rosplc
from tests.lib.waiting import wait_for
from tests.unit.recorder.making import Feed, read_from_the_front


@contextmanager
def talking(namespace: Namespace, topic: str = "/a") -> Iterator[Feed]:
    """Publish numbers all the time."""
    feed, stop = Feed(namespace, topic, slots=1024), threading.Event()

    def talk() -> None:
        number = 0
        while not stop.wait(0.005):
            number += 1
            feed.number(number)

    thread = threading.Thread(target=talk)
    thread.start()
    try:
        yield feed
    finally:
        stop.set()
        thread.join()
        feed.close()


@contextmanager
def started(*arguments: object) -> Iterator[subprocess.Popen[str]]:
    """Run the command as a process; it is dead when the block ends."""
    child = subprocess.Popen(
        [sys.executable, "-m", "rosplc", *map(str, arguments)],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    try:
        yield child
    finally:
        if child.poll() is None:
            child.kill()
        child.communicate()


def begun(child: subprocess.Popen[str]) -> None:
    """Wait until a recorder says that it has begun."""
    assert child.stderr is not None
    for line in child.stderr:
        if "stop with Ctrl-C" in line or "keeping the last" in line:
            return
    raise AssertionError("it ended before it had begun")


def test_record_list_and_replay(shm_namespace: Namespace, tmp_path: Path) -> None:
    """A recording of a second says what it has, is listed, and is replayed into a channel."""
    out = tmp_path / "r.mcap"
    with talking(shm_namespace):
        said = rosplc("record", "--prefix", shm_namespace.prefix, "-o", out, "--duration", "1s", "--json")
    document = json.loads(said.stdout)
    count = document["topics"]["/a"]["received"]
    assert count > 0 and document["files"][0]["topics"] == {"/a": count}
    listed = json.loads(rosplc("replay", out, "--list", "--json").stdout)
    assert listed["topics"]["/a"]["messages"] == count and listed["topics"]["/a"]["direction"] == "to_plc"
    assert "/a" in rosplc("replay", out, "--list").stdout
    replay = ("replay", out, "--to", "plc", "--prefix", shm_namespace.prefix, "--speed", "max", "--wait", "0")
    played = rosplc(*replay, "--rename", "/a:=/b", "--json")
    assert json.loads(played.stdout)["topics"]["/b"]["sent"] == count
    with attach(shm_namespace, "/b") as attached:
        assert attached.snapshot().writer.head == count
    assert f"{count} messages of 1 topic sent" in rosplc(*replay).stdout


@pytest.mark.foreign
def test_ctrl_c_ends_a_recording(shm_namespace: Namespace, tmp_path: Path) -> None:
    """SIGINT ends it in order: with status 0, a report, and a file that is complete."""
    out = tmp_path / "r"
    command = ("record", "--prefix", shm_namespace.prefix, "-o", out, "--bag")
    with talking(shm_namespace), started(*command) as child:
        begun(child)
        wait_for(lambda: any(read_from_the_front(path) for path in out.glob("*.mcap")))
        child.send_signal(signal.SIGINT)
        report, _ = child.communicate(timeout=60)
    assert child.returncode == 0 and "messages of 1 topic" in report
    assert (out / "metadata.yaml").exists() and not list(tmp_path.glob("**/*.tmp"))
    assert json.loads(rosplc("replay", out, "--list", "--json").stdout)["notes"] == []


def test_a_signal_saves_a_ring_buffer(shm_namespace: Namespace, tmp_path: Path) -> None:
    """With --keep nothing is written until SIGUSR1, or a trigger, asks for it."""
    keep = ("record", "--prefix", shm_namespace.prefix, "-o", tmp_path / "ring", "--keep", "1min", "--json")
    with talking(shm_namespace), started(*keep, "--trigger", "/a.pose.position.x < 0") as child:
        begun(child)
        assert not list(tmp_path.iterdir())
        child.send_signal(signal.SIGUSR1)
        wait_for(lambda: any(read_from_the_front(path) for path in tmp_path.glob("ring_*.mcap")))
        child.send_signal(signal.SIGTERM)
        document = json.loads(child.communicate(timeout=60)[0])
    assert child.returncode == 0 and document["saves"] == ["SIGUSR1"] and len(document["files"]) == 1


@pytest.mark.foreign
@pytest.mark.parametrize("keep", [(), ("--keep", "1min")])
def test_a_closed_terminal_ends_a_recording_in_order(
    keep: tuple[str, ...], shm_namespace: Namespace, tmp_path: Path
) -> None:
    """The file gets its end although nothing can be printed any more; a ring buffer is saved."""
    out = tmp_path / "r.mcap"
    with talking(shm_namespace):
        pid, terminal = pty.fork()
        if not pid:
            command = ["record", "--prefix", shm_namespace.prefix, "-o", str(out), *keep]
            os.execv(sys.executable, [sys.executable, "-m", "rosplc", *command])
        try:
            seen = b""
            while b"messages of 1 topic" not in seen:  # its progress
                seen += os.read(terminal, 4096)
        finally:
            os.close(terminal)
        _, status = os.waitpid(pid, 0)
    assert os.waitstatus_to_exitcode(status) == 0
    assert [survey(file).complete for file in tmp_path.glob("*.mcap")] == [True]


def test_triggers_that_cannot_fire_are_named(shm_namespace: Namespace, tmp_path: Path) -> None:
    """A trigger on a topic without a channel, or on one that is left out, is said at the start."""
    keep = ("record", "--prefix", shm_namespace.prefix, "-o", tmp_path / "ring", "--keep", "1min")
    more = ("-x", "/b", "-t", "/nosuch.x > 1", "-t", "/b.data", "-t", "/a.pose.position.x < 0")
    with talking(shm_namespace):
        said = rosplc(*keep, *more, "--duration", "100ms").stderr
    assert "trigger '/nosuch.x > 1': there is no channel /nosuch yet" in said
    assert "trigger '/b.data': /b is not recorded, so the trigger cannot fire" in said
    assert "trigger '/a." not in said


def test_a_classic_topic_is_named(shm_namespace: Namespace, tmp_path: Path) -> None:
    """What a configuration has and a recorder cannot take is said."""
    config = tmp_path / "rosplc.yaml"
    config.write_text(
        f"bridge: b\nprefix: {shm_namespace.prefix}\n"
        "topics: {/old: {type: std_msgs/msg/Bool, to: plc, classic: true}}\n"
    )
    said = rosplc("record", "--config", config, "-o", tmp_path / "r", "--duration", "10ms", code=1)
    assert "/old is a classic topic" in said.stderr


def test_repairing(shm_namespace: Namespace, tmp_path: Path) -> None:
    """A file that was cut is saved beside it, and what was wrong is said."""
    out = tmp_path / "r.mcap"
    with talking(shm_namespace):
        rosplc("record", "--prefix", shm_namespace.prefix, "-o", out, "--duration", "2s")
    out.write_bytes(out.read_bytes()[:-40])
    said = rosplc("record", "--repair", out)
    assert "the file ends or is damaged" in said.stdout and (tmp_path / "r_repaired.mcap").exists()
    facts = json.loads(rosplc("record", "--repair", out, "-o", tmp_path / "again", "--json").stdout)
    assert facts["messages"] > 0 and facts["damaged"] == 0
    rosplc("record", "--repair", out, code=1)  # the name is taken now


@pytest.mark.parametrize(
    "arguments",
    [
        ("record", "--duration", "soon"),
        ("record", "--split-size", "1 lot"),
        ("record", "--compression", "rar"),
        ("record", "--trigger", "stale"),
        ("record", "--after", "1s"),
        ("replay", "x.mcap"),
        ("replay", "x.mcap", "--to", "nowhere"),
        ("replay", "x.mcap", "--to", "plc", "--speed", "fast"),
        ("replay", "x.mcap", "--to", "plc", "--speed", "0"),
        ("replay", "x.mcap", "--to", "plc", "--stamps", "old"),
        ("replay", "x.mcap", "--to", "plc", "--rename", "a=b"),
        ("replay", "x.mcap", "--to", "plc", "--start", "2s", "--end", "1s"),
    ],
)
def test_options_that_cannot_be(arguments: tuple[str, ...]) -> None:
    """A wrong option is refused before anything is opened."""
    rosplc(*arguments, code=2)


def test_what_is_refused_in_words(shm_namespace: Namespace, tmp_path: Path) -> None:
    """No channel, a name that is taken, a file that is none, an unknown topic: each has its error."""
    prefix = ("--prefix", shm_namespace.prefix)
    empty = rosplc("record", *prefix, "-o", tmp_path / "e", "--duration", "100ms", code=1)
    assert "REC004" in empty.stderr and "no channel with the prefix" in empty.stderr
    assert not list(tmp_path.iterdir())
    (tmp_path / "taken.mcap").write_text("mine")
    assert "REC001" in rosplc("record", *prefix, "-o", tmp_path / "taken", code=1).stderr
    assert (tmp_path / "taken.mcap").read_text() == "mine"
    assert "REC003" in rosplc("replay", tmp_path / "taken.mcap", "--to", "plc", code=1).stderr
    assert "REC003" in rosplc("replay", tmp_path / "none.mcap", "--to", "plc", code=1).stderr
    (tmp_path / "folder").mkdir()
    assert "ROS006" in rosplc("replay", tmp_path / "folder", "--to", "plc", code=1).stderr
    # A ring buffer says so at once, not when a trigger has fired.
    unwritable = rosplc("record", *prefix, "--keep", "1s", "-o", tmp_path / "taken.mcap" / "x", code=1)
    assert "REC001" in unwritable.stderr and "keeping" not in unwritable.stderr
    assert "REC005" in rosplc("record", *prefix, "--keep", "1s", "-t", "fault", code=1).stderr
    with talking(shm_namespace):
        rosplc("record", *prefix, "-o", tmp_path / "r", "--duration", "500ms")
        play = ("replay", tmp_path / "r.mcap", "--to", "plc", *prefix)
        assert "REC006" in rosplc(*play, "--topic", "/nothing", code=1).stderr
        assert "SHM116" in rosplc(*play, code=1).stderr
