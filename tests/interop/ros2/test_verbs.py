"""``rosplc pub``, ``echo``, ``hz`` beside a real rclpy: the same messages, the notation that rclpy prints."""

from __future__ import annotations

import importlib
import os
import random
import signal
import subprocess
import sys
import threading
from pathlib import Path

import pytest

from rosplc.cli.ros_text import Writer, as_python
from rosplc.ros.fields import unpack_whole
from tests.codec_oracle import random_value
from tests.interop.graphs import LOCAL, text_of
from tests.interop.ros2.conftest import Peer
from tests.interop.ros2.test_types import INSTALLED, ORACLE, STORE
from tests.lib.waiting import repeat_until, wait_for

pytestmark = [pytest.mark.ros2, pytest.mark.timeout(300), pytest.mark.verifies("ros2-verbs", real="rclpy")]


def start(domain: int, folder: Path, *words: str) -> subprocess.Popen[str]:
    """Start a verb over the dds backend."""
    command = [sys.executable, "-m", "rosplc", *words, "--backend", "dds", "--distro", "kilted"]
    env = {**os.environ, **LOCAL, "ROS_DOMAIN_ID": str(domain)}
    return subprocess.Popen(command, cwd=folder, env=env, stdout=subprocess.PIPE, text=True)


def test_a_real_node_hears_what_is_published(domain: int, peer: Peer, tmp_path: Path) -> None:
    """``--once`` waits until the node has matched."""
    heard = peer.subscribe("/label", "std_msgs/msg/String")
    process = start(
        domain, tmp_path, "pub", "--times", "5", "-r", "20", "/label", "std_msgs/msg/String", "{data: door}"
    )
    process.communicate()
    assert process.returncode == 0
    wait_for(lambda: heard, "a message of rosplc pub")
    assert text_of(peer.payloads("/label")[-1]) == "door"


def test_what_a_real_node_publishes_is_echoed(domain: int, peer: Peer, tmp_path: Path) -> None:
    """Its type is taken from the graph."""
    peer.advertise("/label", "std_msgs/msg/String")
    process = start(domain, tmp_path, "echo", "/label", "--once")
    message = Writer(STORE, "std_msgs/msg/String", {"data": "door"})()
    repeat_until(
        lambda: peer.publish("/label", message), lambda: process.poll() is not None, "the end of rosplc echo"
    )
    assert process.stdout is not None
    assert process.stdout.read() == "data: door\n---\n"


@pytest.mark.parametrize("package", sorted({name.split("/")[0] for name in INSTALLED}))
def test_python_notation_is_that_of_rclpy(package: str) -> None:
    """Compared with ``repr`` of the generated classes, for every bundled type."""
    from rclpy.serialization import deserialize_message

    dice = random.Random(package)
    for name in (each for each in INSTALLED if each.startswith(f"{package}/")):
        _, _, base = name.split("/")
        real = getattr(importlib.import_module(f"{package}.msg"), base)
        data = ORACLE.cdr(name, random_value(ORACLE, name, dice))
        assert as_python(STORE, name, unpack_whole(STORE, name, data)) == repr(
            deserialize_message(data, real)
        )


def test_ctrl_c_ends_hz(domain: int, peer: Peer, tmp_path: Path) -> None:
    """As it ends ros2cli's."""
    peer.advertise("/label", "std_msgs/msg/String")
    process = start(domain, tmp_path, "hz", "/label")
    message = Writer(STORE, "std_msgs/msg/String", {"data": "door"})()
    assert process.stdout is not None
    lines: list[str] = []
    reader = threading.Thread(target=lambda: lines.extend(iter(process.stdout.readline, "")))
    reader.start()
    repeat_until(lambda: peer.publish("/label", message), lambda: lines, "a rate")
    process.send_signal(signal.SIGINT)
    assert process.wait() == 130
    reader.join()
    assert lines[0].startswith("average rate: ")
