"""A robot over DDS, recorded beside the bridge, and replayed onto ROS topics for a listener over DDS."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from rosplc.codec import Codec, Wire
from rosplc.layout import compute_layout
from rosplc.model import TypeStore
from rosplc.ros import Qos, open_backend
from tests.e2e.cell import Bridge
from tests.lib.waiting import wait_for
from tests.unit.recorder.making import read_from_the_front

TYPE = "geometry_msgs/msg/Twist"


@pytest.mark.verify(minutes=0.5)
def test_what_a_robot_sent_comes_again(tmp_path: Path, dds_domain: int, shm_prefix: str) -> None:
    """Every message of a robot is in the recording, and a listener gets each again from its replay."""
    environment = {
        **os.environ,
        "ROS_DOMAIN_ID": str(dds_domain),
        "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST",
    }
    config = tmp_path / "rosplc.yaml"
    config.write_text(
        f"bridge: b\nprefix: {shm_prefix}\nros: {{backend: dds, distro: jazzy}}\n"
        f"topics: {{/cmd_vel: {{type: {TYPE}, to: plc, slots: 1024}}}}\n"
    )
    store = TypeStore.bundled("jazzy")
    codec = Codec(compute_layout(store, TYPE), Wire.CDR)
    sent = [codec.encode(codec.layout.pack({"linear": {"x": float(n)}})) for n in range(1, 51)]
    bridge = Bridge(config, environment)
    robot = open_backend("dds", store, "robot", domain=dds_domain, environment=environment)
    out = tmp_path / "r.mcap"
    command = [sys.executable, "-m", "rosplc"]
    try:
        publisher = robot.advertise("/cmd_vel", TYPE, Qos(depth=100))
        wait_for(lambda: publisher.matched)
        recorder = subprocess.Popen(
            [*command, "record", "--config", str(config), "-o", str(out)], stderr=subprocess.PIPE, text=True
        )
        assert recorder.stderr is not None
        while "recording 1 topic" not in recorder.stderr.readline():
            assert recorder.poll() is None
        for data in sent:
            publisher.write(data)
        wait_for(lambda: len(read_from_the_front(out)) == len(sent))
        recorder.terminate()
        recorder.communicate()
        assert recorder.returncode == 0
    finally:
        robot.close()
        bridge.stop()
    assert [data for _, _, data in read_from_the_front(out)] == sent
    got: list[bytes] = []
    listener = open_backend("dds", store, "listener", domain=dds_domain, environment=environment)
    try:
        listener.subscribe("/again", TYPE, Qos(depth=100), lambda data, _: got.append(data))
        replay = ["replay", str(out), "--to", "ros", "--backend", "dds", "--rename", "/cmd_vel:=/again"]
        done = subprocess.run(
            [*command, *replay, "--wait", "1min"],
            env=environment,
            capture_output=True,
            text=True,
            check=False,
        )
        assert done.returncode == 0, done.stderr
        wait_for(lambda: len(got) == len(sent))
    finally:
        listener.close()
    assert got == sent
