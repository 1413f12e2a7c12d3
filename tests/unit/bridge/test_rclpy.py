"""A whole bridge over rclpy's double: configuration, ROS arguments, both directions, parameters."""

from __future__ import annotations

import importlib.util
from pathlib import Path

import pytest

import rosplc
from rosplc.bridge import Bridge
from rosplc.config import read_config
from rosplc.model import TypeStore
from rosplc.ros import Qos, Reply, RosArguments, fields, open_backend
from rosplc.shm import Namespace
from tests.doubles.ros2 import double
from tests.lib.waiting import wait_for

STORE = TypeStore.bundled("jazzy")
INT32 = "std_msgs/msg/Int32"
DOMAIN = 9  # the double's graph lives in this process alone

pytestmark = [
    pytest.mark.timeout(60),
    pytest.mark.needs(when=importlib.util.find_spec("rclpy") is None, why="the real rclpy is here"),
]


@pytest.mark.parametrize("distro", ["jazzy", "humble"])
def test_bridge_carries_both_ways_and_shows_itself(
    distro: str, tmp_path: Path, shm_namespace: Namespace
) -> None:
    """Messages pass under the names that ROS arguments give, and the node's parameters say what it is."""
    path = tmp_path / "rosplc.yaml"
    path.write_text(
        f"bridge: cell1\nprefix: {shm_namespace.prefix}\n"
        f"ros: {{backend: rclpy, distro: jazzy, domain: {DOMAIN}, rclpy: {{parameters: {{line: north}}}}}}\n"
        f"topics:\n  /down: {{type: {INT32}, to: plc}}\n  /up: {{type: {INT32}, to: ros}}\n"
    )
    arguments = RosArguments.parse(["-r", "__ns:=/robot1", "-r", "/up:=/robot1/up", "-p", "a:=1"])
    with double(distro), Bridge(read_config(path), arguments=arguments) as bridge:
        other = open_backend("rclpy", STORE, "other", domain=DOMAIN)
        source = other.advertise("/down", INT32, Qos())
        got: list[bytes] = []
        sink = other.subscribe("/robot1/up", INT32, Qos(), lambda payload, _: got.append(payload))
        wait_for(lambda: source.matched and sink.matched)
        with (
            rosplc.attach("/down", prefix=shm_namespace.prefix) as down,
            rosplc.attach("/up", prefix=shm_namespace.prefix, write=True) as up,
        ):
            source.write(b"\0\1\0\0\7\0\0\0")
            message = down.wait(timeout=100)
            assert message is not None
            assert message.data == 7
            up.write({"data": 8})
            wait_for(lambda: got)
        assert got == [b"\0\1\0\0\x08\0\0\0"]
        native = bridge.backend._node  # type: ignore[union-attr]
        assert native.get_fully_qualified_name() == "/robot1/rosplc_cell1"
        service, names = "rcl_interfaces/srv/GetParameters", ["bridge", "topics", "config", "line"]
        client = other.client("/robot1/rosplc_cell1/get_parameters", service, Qos())
        wait_for(lambda: client.ready)
        replies: list[Reply] = []
        client.call(fields.pack(STORE, f"{service}_Request", {"names": names}), replies.append)
        wait_for(lambda: replies)
        found = fields.unpack(STORE, f"{service}_Response", replies[0].payload or b"")["values"]
        shown = [each["string_value"] or each["string_array_value"] for each in found]
        assert shown == ["cell1", ["/down", "/up"], str(path), "north"]
        assert [topic.matched for topic in bridge.status().topics] == [1, 1]
        other.close()
