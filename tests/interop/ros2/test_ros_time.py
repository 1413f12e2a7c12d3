"""ROS time in the PLC by the /clock of a node of rclpy, over dds and rclpy."""

from __future__ import annotations

import os
import struct
from pathlib import Path

import pytest

from rosplc.shm import Namespace
from tests.e2e.cell import Bridge, Plc
from tests.interop.graphs import LOCAL
from tests.interop.ros2.conftest import Peer
from tests.lib.waiting import repeat_until

pytestmark = [pytest.mark.ros2, pytest.mark.timeout(300), pytest.mark.verifies("ros-time", real="rclpy")]


@pytest.mark.parametrize("backend", ["dds", "rclpy"])
def test_the_clock_of_a_node_reaches_the_plc(
    tmp_path: Path, shm_namespace: Namespace, domain: int, backend: str
) -> None:
    """With use_sim_time; what goes back goes back in the PLC, and a silent /clock is told again and again."""
    path = tmp_path / "rosplc.yaml"
    path.write_text(
        f"bridge: cell\nprefix: {shm_namespace.prefix}\ntime: {{plc: true, use_sim_time: true}}\n"
        f"ros: {{backend: {backend}, distro: kilted, domain: {domain}}}\n"
    )
    bridge = Bridge(path, {**os.environ, **LOCAL})
    plc, peer = Plc(shm_namespace.prefix, ["/ros_time"], []), Peer(domain)
    seen = plc.seen["/ros_time"]

    def send(second: int) -> None:
        peer.publish("/clock", struct.pack("<4BiI", 0, 1, 0, 0, second, 5))
        plc.scan()

    def has(second: int) -> bool:
        plc.scan()
        return bool(seen) and seen[-1]["now"] == second * 10**9 + 5

    try:
        plc.until(lambda: plc.attached)
        peer.advertise("/clock", "rosgraph_msgs/msg/Clock")
        for second in (100, 200, 50):
            repeat_until(lambda second=second: send(second), lambda second=second: has(second), f"{second} s")
        before = len(seen)
        plc.until(lambda: len(seen) > before + 5)
        assert seen[-1]["sim"] is True
        assert has(50)
        assert bridge.stop() == 0
    finally:
        bridge.kill()
        peer.close()
