"""The block of a pose, executed: what it makes of the bridge's records, and of their absence."""

from __future__ import annotations

from collections.abc import Iterator
from functools import lru_cache
from typing import Any

import pytest

from rosplc.config import Project, TopicPlan, parse_config, resolve
from rosplc.config.transforms import TransformError
from rosplc.plc.build import plc_project
from rosplc.plc.plan import ProjectOptions
from rosplc.shm import Direction, OwnedChannel
from rosplc_st.build import Build, build
from rosplc_st.machine import LibraryMachine
from tests.verification.plc_cell import READ, TARGETS, Cell, project_texts

CONFIG = """
transforms:
  tool: {target: base, source: tool, rate: 100Hz, max_age: 300ms}
  camera: {target: base, source: camera, rate: 20Hz, max_age: never}
"""
TOOL = "ROS_Read.transforms_tool"
POSE = {"translation": {"x": 1.5, "y": -2.0, "z": 0.25}, "rotation": {"z": 0.6, "w": 0.8}}
NO_POSE: dict[str, Any] = {"translation": {}, "rotation": {"w": 1.0}}


@lru_cache
def project() -> Project:
    return resolve(parse_config(CONFIG))


@lru_cache
def built(target: str, pins: bool) -> Build:
    options, toolchain, processor = TARGETS[target]
    made = plc_project(project(), ProjectOptions(target=processor, pins=pins))
    return build(project_texts(made), options, toolchain)


class Rig(Cell):
    """The PLC, and the bridge's end of the tool's channel."""

    def __init__(self, made: Build) -> None:
        super().__init__(machine=lambda folder: Started(made, folder))
        self.plan: TopicPlan = project().topic("/transforms/tool")
        self.owned: OwnedChannel = self.channel(self.plan.topic, self.plan.layout, Direction.TO_PLC)
        self.writer = self.owned.writer(100)

    def run(self, count: int = 1) -> None:
        """Scan every 10 ms, while the bridge beats."""
        for _ in range(count):
            self.writer.beat()
            self.machine.scan(READ, step=10)

    def write(self, *, stamp_ns: int = 0, **fields: Any) -> None:
        """Write a record as the bridge does, and scan until the PLC has it."""
        value = {"transform": POSE, "frame": "wrist", **fields}
        sequence = self.writer.publish(self.plan.layout.pack(value), stamp_ns=stamp_ns)
        for _ in range(10):
            self.run()
            if self.of("udiSequence") == sequence:
                return
        raise AssertionError("the record was not taken")

    def of(self, *names: str) -> Any:
        found = tuple(self.machine.get(f"{TOOL}.{name}") for name in names)
        return found if len(found) > 1 else found[0]

    @property
    def state(self) -> tuple[bool, TransformError, str]:
        valid, error, frame = self.of("xValid", "eTransform", "sFrame")
        return bool(valid), TransformError(error), frame

    @property
    def x(self) -> float:
        return float(self.of("stPose.translation.x"))


class Started(LibraryMachine):
    """A machine that has started; the cell's own topics are not part of it."""

    def set(self, path: str, value: Any) -> None:
        if path.startswith("ROS_Write"):
            return
        super().set(path, value)


@pytest.fixture(params=[("64-bit", False), ("64-bit", True), ("32-bit-with-barrier", False)])
def rig(request: pytest.FixtureRequest) -> Iterator[Rig]:
    with Rig(built(*request.param)) as made:
        while made.of("xAttached", "xPeerAlive") != (True, True):
            made.run()
        yield made


def test_a_pose_and_its_age(rig: Rig) -> None:
    """The age is what the bridge knew, and what has passed since by the PLC's clock, up to max_age."""
    rig.run()
    assert rig.state == (False, TransformError.NO_BRIDGE, "")
    rig.write(age_ms=120, stamp_ns=7_000_000_005)
    assert rig.state == (True, TransformError.NONE, "wrist")
    assert rig.of("stPose.translation.x", "stPose.translation.y", "stPose.translation.z") == (1.5, -2.0, 0.25)
    assert rig.of("stPose.rotation.z", "stPose.rotation.w") == (0.6, 0.8)
    assert rig.of("uliStamp", "xStatic", "tAge") == (7_000_000_005, False, 120)
    rig.run(18)
    assert rig.of("tAge") == 300
    assert rig.state == (True, TransformError.NONE, "wrist")
    rig.run()
    assert rig.of("tAge") == 310
    assert rig.state == (False, TransformError.TOO_OLD, "wrist")
    rig.write(age_ms=4)
    assert rig.state == (True, TransformError.NONE, "wrist")


@pytest.mark.parametrize("error", [each for each in TransformError if each > TransformError.NO_BRIDGE])
def test_an_error_keeps_the_last_valid_pose(rig: Rig, error: TransformError) -> None:
    """The program sees which frame it is about; the next pose is valid at once."""
    rig.write()
    rig.write(transform=NO_POSE, error=error, frame="elbow")
    assert rig.state == (False, error, "elbow")
    assert rig.x == 1.5
    rig.write(transform={"translation": {"x": 9.0}, "rotation": {"w": 1.0}})
    assert (rig.state, rig.x) == ((True, TransformError.NONE, "wrist"), 9.0)


def test_a_static_pose_has_no_greatest_age(rig: Rig) -> None:
    """It is valid for as long as the bridge lives and writes."""
    rig.write(is_static=True, frame="")
    rig.run(60)
    assert rig.of("tAge", "xStatic") == (600, True)
    assert rig.state == (True, TransformError.NONE, "")


def test_a_bridge_that_is_silent(rig: Rig) -> None:
    """Without its beat, or with its beat alone, the pose does not stay valid."""
    rig.write(is_static=True)
    for _ in range(60):
        rig.machine.scan(READ, step=10)
    assert rig.state == (False, TransformError.NO_BRIDGE, "")
    rig.write(is_static=True)
    assert rig.state[0]
    rig.run(101)  # longer than the second after which a record is missing
    assert rig.of("xPeerAlive") and rig.of("xStale")
    assert rig.state == (False, TransformError.NO_BRIDGE, "")


def test_an_age_beyond_49_days_stays_there(rig: Rig) -> None:
    """The sum does not start at zero again."""
    rig.write(age_ms=2**32 - 5)
    rig.run(2)
    assert rig.of("tAge") == 2**32 - 1
    assert rig.state == (False, TransformError.TOO_OLD, "wrist")


def test_names_in_the_plc() -> None:
    """All poses have one block; an entry without a greatest age gives it none."""
    texts = project_texts(plc_project(project(), ProjectOptions()))
    for name in ("camera", "tool"):
        assert f"    transforms_{name} : RosPlc_Pose('/transforms/{name}');" in texts["ROS_Read"]
    calls = texts[READ]
    assert "tMaxAge := T#300ms" in calls.partition("ROS_Read.transforms_tool(")[2].splitlines()[0]
    assert "tMaxAge" not in calls.partition("ROS_Read.transforms_camera(")[2].splitlines()[0]
