"""Poses on the whole way: a node publishes, a bridge over dds carries, and the PLC's block has them."""

from __future__ import annotations

import time
from collections.abc import Iterator

import pytest

from rosplc.config.transforms import TF_MESSAGE, TransformError
from rosplc.ros import Qos
from tests.verification.joint import RULES, Joint, encode, made_joint

pytestmark = [pytest.mark.timeout(200), pytest.mark.verifies("ros-blocks", own="translated Structured Text")]

CONFIG = """
bridge: poses
ros: {backend: BACKEND, domain: 47}
shm: {directory: FOLDER}
tasks: {RosTask: {interval: 2ms}}
transforms: {tool: {target: base, source: tool, rate: 100Hz, max_age: 1min}}
"""
TOOL = "transforms_tool"


@pytest.fixture(params=["dds", *RULES])
def joint(request: pytest.FixtureRequest) -> Iterator[Joint]:
    """Give a PLC with a bridge over ``dds``, or made by each rule."""
    backend, rule = ("dds", "64-bit") if request.param == "dds" else ("memory", request.param)
    with made_joint(CONFIG.replace("BACKEND", backend), "ROS_Read", 47, backend, rule=rule) as made:
        yield made


def link(child: str, parent: str, height: float, stamp_ns: int = 0) -> bytes:
    """Return a message with one transform."""
    seconds, nanoseconds = divmod(stamp_ns, 10**9)
    header = {"frame_id": parent, "stamp": {"sec": seconds, "nanosec": nanoseconds}}
    pose = {"translation": {"z": height}, "rotation": {"w": 1.0}}
    transform = {"header": header, "child_frame_id": child, "transform": pose}
    return encode(TF_MESSAGE, transforms=[transform])


def test_from_the_node_to_the_block_and_through_a_restart(joint: Joint) -> None:
    """A bridge that comes later has the static transforms of both nodes again; meanwhile nothing is valid."""

    def state(error: TransformError, valid: bool = False) -> None:
        joint.until(lambda: joint.get(TOOL, "eTransform", "xValid") == (error, valid), error.name)

    for child, parent in (("tool", "flange"), ("arm", "base")):
        latched = Qos(durability="transient_local", depth=1)
        joint.peer.advertise("/tf_static", TF_MESSAGE, latched).write(link(child, parent, 1.0))
    state(TransformError.NOT_CONNECTED)
    assert joint.get(TOOL, "sFrame") == "flange"
    moving = joint.peer.advertise("/tf", TF_MESSAGE, Qos())
    joint.until(lambda: moving.matched, "the bridge's subscription")
    stamp = time.time_ns()
    moving.write(link("flange", "arm", 0.5, stamp))
    state(TransformError.NONE, valid=True)
    assert joint.get(TOOL, "stPose.translation.z", "uliStamp", "sFrame") == (2.5, stamp, "flange")
    assert 0 <= joint.get(TOOL, "tAge") < 60_000
    joint.until(lambda: joint.get(TOOL, "udiSources") == 3, "the number of publishers")
    joint.stop_bridge() if joint.backend == "memory" else joint.kill_bridge()
    state(TransformError.NO_BRIDGE)
    assert joint.get(TOOL, "stPose.translation.z") == 2.5
    joint.start_bridge()
    state(TransformError.NOT_CONNECTED)
    joint.until(lambda: moving.matched, "the bridge's subscription")
    moving.write(link("flange", "arm", 1.5, time.time_ns()))
    state(TransformError.NONE, valid=True)
    assert joint.get(TOOL, "stPose.translation.z") == 3.5
