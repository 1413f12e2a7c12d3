"""/rosout as a node of rclpy receives it: the bridge's log and the PLC's, over dds and rclpy."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import pytest
from rosbags.typesys import Stores, get_typestore

from rosplc.shm import Namespace
from tests.e2e.cell import Bridge, Plc
from tests.interop.graphs import LOCAL
from tests.interop.ros2.conftest import Peer
from tests.lib.waiting import wait_for

pytestmark = [pytest.mark.ros2, pytest.mark.timeout(300), pytest.mark.verifies("rosout", real="rclpy")]

TYPE = "rcl_interfaces/msg/Log"


@pytest.mark.parametrize("backend", ["dds", "rclpy"])
def test_both_logs_reach_a_late_subscriber(
    tmp_path: Path, shm_namespace: Namespace, domain: int, backend: str
) -> None:
    """A reliable, transient local subscriber gets what was logged before it came, under the node's name."""
    path = tmp_path / "rosplc.yaml"
    path.write_text(
        f"bridge: cell\nprefix: {shm_namespace.prefix}\n"
        f"ros: {{backend: {backend}, distro: kilted, domain: {domain}, namespace: /line}}\n"
        "rosout: {plc: true}\ntopics:\n  /label: {type: std_msgs/msg/String, to: ros}\n"
    )
    bridge = Bridge(path, {**os.environ, **LOCAL})
    plc = Plc(shm_namespace.prefix, [], ["/rosout"])
    peer = Peer(domain)
    store = get_typestore(Stores.ROS2_KILTED)

    def fill(message: Any) -> None:
        message.level, message.msg = 40, "overheated"

    try:
        plc.write("/rosout", fill)
        plc.until(lambda: plc.writes["/rosout"].udiTaken)
        peer.subscribe("/rosout", TYPE, latched=True, depth=1000)

        def lines() -> dict[str, Any]:
            found: list[Any] = [store.deserialize_cdr(data, TYPE) for data in peer.payloads("/rosout")]
            return {line.msg: line for line in found}

        wait_for(lambda: "overheated" in lines() and any(text.startswith("bridge cell") for text in lines()))
        assert (lines()["overheated"].name, lines()["overheated"].level) == ("line.rosplc_cell.plc", 40)
        (own,) = [line for text, line in lines().items() if text.startswith("bridge cell carries")]
        assert (own.name, own.level) == ("line.rosplc_cell", 20)
        assert own.stamp.sec > 1_600_000_000
        assert bridge.stop() == 0
    finally:
        bridge.kill()
        peer.close()
