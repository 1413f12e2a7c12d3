"""Every example does what it says, as a process of its own."""

from __future__ import annotations

import contextlib
import csv
import io
import subprocess
import sys
import threading
from pathlib import Path

import pytest

import rosplc
from rosplc.bridge.engine import Bridge
from rosplc.codec import Codec, Wire
from rosplc.config.file import read_config
from rosplc.ros import DEFAULT, open_backend
from tests.lib.waiting import wait_for

EXAMPLES = Path(__file__).resolve().parents[2] / "examples"


@contextlib.contextmanager
def example(name, *arguments):
    child = subprocess.Popen(
        [sys.executable, str(EXAMPLES / name), *map(str, arguments)],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    try:
        yield child
    finally:
        child.kill()
        child.communicate()


@pytest.fixture
def prefix(shm_namespace):
    return shm_namespace.prefix


def test_cell(prefix, tmp_path):
    """The cell's PLC gets every part and answers with lists of four, screws making them urgent."""
    text = (EXAMPLES / "cell" / "rosplc.yaml").read_text()
    (tmp_path / "msg").symlink_to(EXAMPLES / "cell" / "msg")
    path = tmp_path / "rosplc.yaml"
    path.write_text(text.replace("prefix: cell", f"prefix: {prefix}"))
    bridge = Bridge(read_config(path))
    bridge.backend = open_backend("memory", bridge.project.store, "bridge")
    robot = open_backend("memory", bridge.project.store, "robot")
    part = Codec(bridge.project.topic("/camera/part").layout, Wire.CDR)
    wanted = Codec(bridge.project.topic("/pick_list").layout, Wire.CDR)
    lists = []
    with bridge, example("cell/plc.py", "--prefix", prefix, "--seconds", 600) as child:
        robot.subscribe(
            "/pick_list",
            "cell_msgs/msg/PickList",
            DEFAULT,
            lambda data, _: lists.append(wanted.layout.view(wanted.decode(data))),
        )
        camera = robot.advertise("/camera/part", "cell_msgs/msg/Part", DEFAULT)

        def ready():
            status = {topic.topic: topic for topic in bridge.status().topics}
            return all(topic.peer_alive for topic in status.values()) or child.poll() is not None

        wait_for(ready, "the PLC at work")
        for number in range(8):
            kind = 1 if number == 5 else 2
            camera.write(part.encode(part.layout.pack({"kind": kind, "x": number, "label": f"p{number}"})))
        wait_for(lambda: len(lists) == 2, "two lists")
    robot.close()
    assert [[each.label for each in one.parts] for one in lists] == [
        ["p0", "p1", "p2", "p3"],
        ["p4", "p5", "p6", "p7"],
    ]
    assert [one.urgent for one in lists] == [False, True]
    assert lists[0].header.frame_id == "table"


def test_log_channel(prefix):
    """Each message becomes one line with its fields as columns."""
    stop = threading.Event()
    with rosplc.bind("/cmd_vel", "geometry_msgs/msg/Twist", prefix=prefix, slots=64) as channel:

        def talk():
            number = 0
            while not stop.wait(0.01):
                number += 1
                channel.write({"linear": {"x": float(number)}})

        thread = threading.Thread(target=talk)
        thread.start()
        try:
            with example("log_channel.py", "/cmd_vel", "--prefix", prefix, "--count", 5) as child:
                out, err = child.communicate(timeout=60)
        finally:
            stop.set()
            thread.join()
    assert (child.returncode, err) == (0, "")
    rows = list(csv.DictReader(io.StringIO(out)))
    first = float(rows[0]["linear.x"])
    assert [float(row["linear.x"]) for row in rows] == [first + number for number in range(5)]
    assert rows[0].keys() >= {"sequence", "stamp_ns", "lost", "angular.z"}


def test_log_channel_without_a_channel(prefix):
    """A topic that is not there is one clear line and status 1."""
    with example("log_channel.py", "/nothing", "--prefix", prefix) as child:
        _, err = child.communicate(timeout=60)
    assert child.returncode == 1
    assert "SHM101" in err
    assert "Traceback" not in err


def test_own_loop(prefix):
    """The loop's measurement reaches a PLC's side, and the PLC's set point reaches the loop."""
    with example("own_loop.py", "--prefix", prefix, "--seconds", 600) as child:
        with rosplc.attach("/temperature", prefix=prefix, timeout=60) as temperature:
            assert 15.0 <= temperature.wait(60).data <= 25.0
        with rosplc.attach("/setpoint", prefix=prefix, write=True, timeout=60) as setpoint:
            setpoint.write({"data": 21.5})
            assert child.stdout.readline() == "the PLC asks for 21.5\n"
