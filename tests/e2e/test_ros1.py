"""The whole way on ROS 1: the thesis' own world of roscpp and rospy nodes, a bridge, and a PLC."""

from __future__ import annotations

import json
import os
import struct
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import pytest

from rosplc.config.transforms import TransformError
from rosplc.ros import Qos
from tests.e2e.cell import Bridge, Plc
from tests.interop.ros1.graph import PACKAGES, Graph, lend
from tests.interop.ros1.test_peers import PART, part_defines, string
from tests.lib.waiting import wait_for

pytestmark = [
    pytest.mark.needs(*PACKAGES),
    pytest.mark.timeout(60),
    pytest.mark.verifies("ros1", real="rosmaster"),
]

TWIST = struct.Struct("<6d")


def config(folder: Path, prefix: str, extra: str = "") -> Path:
    """Write a bridge's configuration on ROS 1."""
    path = folder / f"{prefix}.yaml"
    path.write_text(
        f"bridge: {prefix}\nprefix: {prefix}\nros: {{backend: rospy, distro: noetic, node_name: {prefix}}}\n"
        f"tasks: {{RosTask: {{interval: 5ms}}}}\n{extra}"
        "topics:\n"
        "  /cmd_vel: {type: geometry_msgs/msg/Twist, to: plc}\n"
        "  /pose: {type: geometry_msgs/msg/PoseStamped, to: ros}\n"
        "  /label: {type: std_msgs/msg/String, to: ros}\n"
        + ("  /parts: {type: cell_msgs/msg/Part, to: plc}\n" if "types:" in extra else "")
    )
    return path


def cell_plc(prefix: str, *more: str) -> Plc:
    """Return the PLC of that configuration."""
    return Plc(prefix, ("/cmd_vel", *more), ("/pose", "/label"))


@pytest.fixture
def ros1() -> Iterator[Graph]:
    with lend() as graph:
        yield graph


@pytest.mark.parametrize("kind", ["roscpp", "rospy"])
def test_values_cross_between_ros1_and_the_plc(
    ros1: Graph, kind: str, tmp_path: Path, shm_prefix: str
) -> None:
    """Every value that a ROS 1 node sends reaches the PLC, and every one that the PLC writes reaches it."""
    peer = ros1.peer(kind, "robot")
    heard, labels = (
        peer.subscribe("/pose", "geometry_msgs/PoseStamped"),
        peer.subscribe("/label", "std_msgs/String"),
    )
    said = peer.advertise("/cmd_vel", "geometry_msgs/Twist")
    bridge = Bridge(config(tmp_path, shm_prefix), ros1.variables)
    try:
        plc = cell_plc(shm_prefix)
        plc.until(lambda: plc.attached)
        plc.until(lambda: peer.matched("/cmd_vel") and peer.matched("/pose") and peer.matched("/label"))
        assert f"/{shm_prefix}" in ros1.run("rosnode", "list").split()
        sent = [(i + 0.5, -i / 3, 1e-300, 0.1, 1e300, i * 0.25) for i in range(200)]
        for number, values in enumerate(sent, 1):
            said.write(TWIST.pack(*values))
            plc.until(lambda n=number: len(plc.seen["/cmd_vel"]) == n)  # the channel holds few messages
        got = [
            tuple(message[part][axis] for part in ("linear", "angular") for axis in "xyz")
            for message in plc.seen["/cmd_vel"]
        ]
        assert got == sent
        for i in range(100):

            def fill(message: Any, i: int = i) -> None:
                message.header.stamp.sec, message.header.stamp.nanosec = i, 999_999_999
                message.header.frame_id = f"map{i}"
                message.pose.position.x, message.pose.orientation.w = i / 7, 1.0

            plc.write("/pose", fill)
            plc.write("/label", lambda message, i=i: setattr(message, "data", f"part {i} Ölkännchen"))
            plc.until(lambda n=i + 1: len(heard.payloads()) == n and len(labels.payloads()) == n)
        for i, payload in enumerate(heard.payloads()):
            frame = string(f"map{i}")
            assert payload[4:12] == struct.pack("<II", i, 999_999_999)
            assert payload[12 : 12 + len(frame)] == frame
            assert struct.unpack("<7d", payload[12 + len(frame) :]) == (i / 7, 0, 0, 0, 0, 0, 1)
        assert labels.payloads() == [string(f"part {i} Ölkännchen") for i in range(100)]
    finally:
        assert bridge.stop() == 0, bridge.log.read_text()


def test_type_from_the_wire_reaches_the_plc(ros1: Graph, tmp_path: Path, shm_prefix: str) -> None:
    """A type that only a roscpp program knows is saved from the wire, configured, and read by the PLC."""
    peer = ros1.peer("roscpp", "robot", *part_defines())
    said = peer.advertise("/parts", PART)
    command = [
        sys.executable,
        "-m",
        "rosplc",
        "types",
        "--from-topic",
        "/parts",
        "--save",
        str(tmp_path / "msg"),
    ]
    saved = subprocess.run(
        [*command, "--json"], env=ros1.variables, capture_output=True, text=True, check=True
    )
    assert json.loads(saved.stdout)["type"] == PART
    bridge = Bridge(config(tmp_path, shm_prefix, f"types: {{paths: [{tmp_path / 'msg'}]}}\n"), ros1.variables)
    try:
        plc = cell_plc(shm_prefix, "/parts")
        plc.until(lambda: plc.attached)
        plc.until(lambda: peer.matched("/parts"))
        weights = struct.pack("<I2f", 2, 0.5, 2.0)
        said.write(bytes(12) + string("base") + string("S-17") + bytes(56) + weights + b"\1")
        plc.until(lambda: plc.seen["/parts"])
        (part,) = plc.seen["/parts"]
        assert (part["serial"], part["weights"], part["state"]) == ("S-17", [0.5, 2.0], 1)
        assert part["header"]["frame_id"] == "base"
    finally:
        assert bridge.stop() == 0, bridge.log.read_text()


def test_bytes_that_are_no_message_stop_at_the_bridge(ros1: Graph, tmp_path: Path, shm_prefix: str) -> None:
    """Bytes that do not fit the type are refused by the bridge; the PLC sees none of them."""
    from rosplc.model import TypeStore
    from rosplc.ros import Qos, open_backend

    bridge = Bridge(config(tmp_path, shm_prefix), ros1.variables)
    broken = open_backend("rospy", TypeStore.bundled("noetic"), "broken", environment=ros1.environment)
    try:
        outbox = broken.advertise("/cmd_vel", "geometry_msgs/msg/Twist", Qos(depth=1000))
        plc = cell_plc(shm_prefix)
        plc.until(lambda: plc.attached and outbox.matched)
        for bad in (b"", b"x", bytes(47), bytes(49), bytes(1 << 16)):
            outbox.write(bad)
        outbox.write(TWIST.pack(1, 2, 3, 4, 5, 6))
        plc.until(lambda: plc.seen["/cmd_vel"])
        assert [message["linear"]["x"] for message in plc.seen["/cmd_vel"]] == [1.0]
    finally:
        broken.close()
        assert bridge.stop() == 0, bridge.log.read_text()
    assert "COD" in bridge.log.read_text() or "refused" in bridge.log.read_text()


@pytest.mark.verify(minutes=2)
def test_everything_dies_and_comes_back(ros1: Graph, tmp_path: Path, shm_prefix: str) -> None:
    """Master, bridge and robot are killed in the stream, one after the other, and each time it continues."""
    path = config(tmp_path, shm_prefix)
    with ExitStack() as stack:
        bridge = Bridge(path, ros1.variables)
        stack.callback(lambda: bridge.kill())
        peer = ros1.peer("roscpp", "robot")
        plc = cell_plc(shm_prefix)
        number = 0

        def open_peer() -> tuple[Any, Any]:
            return peer.advertise("/cmd_vel", "geometry_msgs/Twist"), peer.subscribe(
                "/label", "std_msgs/String"
            )

        def crosses(said: Any, heard: Any) -> None:
            """Messages of now cross both ways."""
            nonlocal number
            number += 1
            word = f"now {number}"
            plc.until(lambda: plc.attached)

            def both() -> bool:
                said.write(TWIST.pack(number, 0, 0, 0, 0, 0))
                if plc.writes["/label"].xReady:
                    plc.write("/label", lambda message: setattr(message, "data", word))
                return (
                    any(message["linear"]["x"] == number for message in plc.seen["/cmd_vel"])
                    and string(word) in heard.payloads()
                )

            plc.until(both)

        said, heard = open_peer()
        crosses(said, heard)
        for _ in range(3):
            ros1.kill_master()
            crosses(said, heard)  # those who know each other need no master
            ros1.start_master()
            wait_for(lambda: f"/{shm_prefix}" in ros1.run("rosnode", "list"))
            crosses(said, heard)
            # A roscpp node that outlives its master is known to the next one only if it starts again.
            peer.kill()
            peer = ros1.peer("roscpp", "robot")
            said, heard = open_peer()
            crosses(said, heard)
            bridge.kill()
            bridge = Bridge(path, ros1.variables)
            crosses(said, heard)
        numbers = [message["linear"]["x"] for message in plc.seen["/cmd_vel"]]
        assert numbers == sorted(numbers)  # nothing old came as new
        assert os.path.exists(bridge.log)
        assert bridge.stop() == 0, bridge.log.read_text()


def test_rosnode_kill_ends_the_program(ros1: Graph, tmp_path: Path, shm_prefix: str) -> None:
    """The bridge says who told it to leave and ends with status 3: respawn starts it again."""
    bridge = Bridge(config(tmp_path, shm_prefix), ros1.variables)
    try:
        wait_for(lambda: f"/{shm_prefix}" in ros1.run("rosnode", "list"))
        wait_for(lambda: "carries 3 topics" in bridge.log.read_text())
        assert "killed" in ros1.run("rosnode", "kill", f"/{shm_prefix}")
        assert bridge.wait() == 3, bridge.log.read_text()
        assert "to shut down" in bridge.log.read_text()
        assert "error ROS015" in bridge.log.read_text()
    finally:
        bridge.kill()


@pytest.mark.needs("python3-tf2-msgs")
def test_transforms_of_rospy_nodes(ros1: Graph, tmp_path: Path, shm_prefix: str) -> None:
    """Latched static transforms of two nodes from before, and a moving one, are a pose in the PLC."""

    def link(child: str, parent: str, stamp_ns: int = 0) -> bytes:
        head = struct.pack("<4I", 1, 7, *divmod(stamp_ns, 10**9))
        return head + string(parent) + string(child) + struct.pack("<7d", 1, 0, 0, 0, 0, 0, 1)

    kind, latched = "tf2_msgs/TFMessage", Qos(durability="transient_local", depth=1)
    for number, pair in enumerate((("tool", "/flange"), ("arm", "base"))):
        ros1.peer("rospy", f"static{number}").advertise("/tf_static", kind, latched).write(link(*pair))
    moving = ros1.peer("rospy", "robot")
    said = moving.advertise("/tf", kind)
    path, pose = tmp_path / "rosplc.yaml", "/transforms/tool"
    path.write_text(
        f"prefix: {shm_prefix}\nros: {{backend: rospy, distro: noetic}}\n"
        "transforms: {tool: {target: base, source: tool, rate: 100Hz}}\n"
    )
    bridge = Bridge(path, ros1.variables)
    try:
        plc = Plc(shm_prefix, (pose,), ())

        def newest(error: TransformError) -> bool:
            return bool(plc.seen[pose]) and plc.seen[pose][-1]["error"] == error

        plc.until(lambda: newest(TransformError.NOT_CONNECTED) and moving.matched("/tf"))
        assert plc.seen[pose][-1]["frame"] == "flange"
        said.write(link("flange", "arm", time.time_ns()))
        plc.until(lambda: newest(TransformError.NONE))
        assert plc.seen[pose][-1]["transform"]["translation"]["x"] == 3.0
        plc.until(lambda: newest(TransformError.TOO_OLD))
    finally:
        assert bridge.stop() == 0, bridge.log.read_text()
