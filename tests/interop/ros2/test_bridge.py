"""A whole bridge between a PLC and a real rclpy node: values both ways, and after a kill of either side."""

from __future__ import annotations

import os
import struct
from pathlib import Path

import pytest

from rosplc.shm import Namespace
from tests.e2e.cell import Bridge, Plc
from tests.interop.graphs import LOCAL, text_of
from tests.interop.ros2.conftest import Peer
from tests.lib.waiting import repeat_until

pytestmark = [
    pytest.mark.ros2,
    pytest.mark.timeout(300),
    pytest.mark.verifies("ros2-topics", real="rclpy on Fast DDS"),
]

TWIST = struct.Struct("<6d")


@pytest.mark.parametrize("backend", ["dds", "rclpy"])
def test_values_cross_and_outlive_kills(
    tmp_path: Path, shm_namespace: Namespace, domain: int, backend: str
) -> None:
    """Messages of a node reach the PLC and its own reach the node; so they do with successors of both."""
    prefix = shm_namespace.prefix
    path = tmp_path / "rosplc.yaml"
    path.write_text(
        f"bridge: cell\nprefix: {prefix}\nros: {{backend: {backend}, distro: kilted, domain: {domain}}}\n"
        "topics:\n  /cmd_vel: {type: geometry_msgs/msg/Twist, to: plc}\n"
        "  /label: {type: std_msgs/msg/String, to: ros}\n"
    )
    bridge, peer = Bridge(path, {**os.environ, **LOCAL}), Peer(domain)
    plc = Plc(prefix, ["/cmd_vel"], ["/label"])
    try:
        exchange(plc, peer, 1)
        bridge.kill()
        bridge = Bridge(path, {**os.environ, **LOCAL})
        exchange(plc, peer, 2)
        peer.process.kill()
        peer.close()
        peer = Peer(domain, "successor")
        exchange(plc, peer, 3)
        assert bridge.stop() == 0
    finally:
        bridge.kill()
        peer.close()


def exchange(plc: Plc, peer: Peer, number: int) -> None:
    """Send from both sides until the other has it; what is sent before they have matched may be lost."""
    velocity = TWIST.pack(number, 0, 0, 0, 0, -number)
    if "/label" not in peer.heard:
        peer.subscribe("/label", "std_msgs/msg/String")
        peer.advertise("/cmd_vel", "geometry_msgs/msg/Twist")

    def act() -> None:
        peer.publish("/cmd_vel", b"\0\1\0\0" + velocity)
        plc.write("/label", lambda message: setattr(message, "data", f"label {number}"))
        plc.scan()

    def arrived() -> bool:
        plc.scan()
        labels = [text_of(data) for data in peer.payloads("/label")]
        speeds = [message["linear"]["x"] for message in plc.seen["/cmd_vel"]]
        return f"label {number}" in labels and number in speeds

    repeat_until(act, arrived, f"round {number}")
