"""Safe messages of the configuration, executed: the PLC's bytes are those that the bridge's packer gives."""

from __future__ import annotations

import shutil
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from rosplc.layout import Limits
from rosplc.plc.build import build_project
from rosplc.plc.plan import PlcTask, PlcTopic, ProjectOptions
from rosplc_st.build import build
from rosplc_st.machine import LibraryMachine, Machine, ProcessMachine
from tests.verification.plc_cell import READ, TARGETS, layout_of, project_texts, store, targets

pytestmark = pytest.mark.verifies("fail-safe", own="translated Structured Text")

SMALL = Limits(string=20, sequence=4)
VALUES: dict[str, tuple[str, dict[str, Any]]] = {
    "/v_joints": (
        "sensor_msgs/msg/JointState",
        {"header": {"frame_id": "a,(b"}, "name": ["x'y", "$", "\u00e4"], "position": [-1, 2.5e-300, 1e22]},
    ),
    "/v_empty": ("sensor_msgs/msg/JointState", {"name": [], "velocity": []}),
    "/v_polygon": ("geometry_msgs/msg/Polygon", {"points": [{"x": 1, "y": -0.1}, {}, {"z": 3}]}),
    "/v_pose": ("geometry_msgs/msg/PoseStamped", {"pose": {"orientation": {"z": -1e-9}}}),
    "/v_defaults": ("geometry_msgs/msg/Quaternion", {}),
    "/v_covariance": (
        "geometry_msgs/msg/PoseWithCovariance",
        {"covariance": [i * 0.5 for i in range(36)], "pose": {"position": {"y": 1}}},
    ),
    "/v_battery": (
        "sensor_msgs/msg/BatteryState",
        {"present": True, "power_supply_status": 255, "voltage": 0.1, "cell_voltage": [1.5]},
    ),
    "/v_array": (
        "std_msgs/msg/Int64MultiArray",
        {
            "layout": {"dim": [{"label": "a", "size": 2**32 - 1}, {}], "data_offset": 1},
            "data": [-(2**63), 2**63 - 1],
        },
    ),
    "/v_unsigned": ("std_msgs/msg/UInt64", {"data": 2**64 - 1}),
    "/v_text": ("std_msgs/msg/String", {"data": "20 characters of text"[:20]}),
}  # fmt: skip


@pytest.fixture(params=targets(pytest.mark.verify(minutes=1)))
def machine(request: pytest.FixtureRequest) -> Iterator[Machine]:
    options, toolchain, processor = TARGETS[request.param]
    topics = [
        PlcTopic(
            topic, layout_of(type_name, limits=SMALL), "read", "RosTask",
            stale_after_ns=10**9, on_stale="value", safe=value,
        )
        for topic, (type_name, value) in VALUES.items()
    ]  # fmt: skip
    project = build_project(store(), topics, [PlcTask("RosTask")], ProjectOptions(target=processor))
    built = build(project_texts(project), options, toolchain, program=toolchain is not None)
    folder = Path(tempfile.mkdtemp(prefix="T", dir="/dev/shm"))
    made = (ProcessMachine if built.toolchain.runner else LibraryMachine)(built, str(folder))
    made.start()
    yield made
    if isinstance(made, ProcessMachine):
        made.kill()
    shutil.rmtree(folder)


@pytest.mark.foreign
def test_the_safe_message_is_what_the_configuration_says(machine: Machine) -> None:
    """Each message has exactly the record that the configuration's value gives, from the first scan on."""
    machine.scan(READ, step=10)
    for topic, (type_name, value) in VALUES.items():
        layout = layout_of(type_name, limits=SMALL)
        block = f"ROS_Read.{topic[1:]}"
        assert machine.get(f"{block}.xSubstituted") is True
        assert machine.read(f"{block}.msg") == bytes(layout.pack(value)), topic
