"""Message types cross the generated blocks in both directions and come out equal."""

from __future__ import annotations

from typing import Literal

import pytest

from rosplc.layout import Limits
from rosplc.plc.plan import ProjectOptions
from rosplc_st.build import ARMHF
from rosplc_st.translator import Options
from tests.verification.crossing import Crossing
from tests.verification.plc_cell import layout_of, needs_armhf, store

LIMITS = Limits(string=20, sequence=3)
SAMPLE = (
    "geometry_msgs/msg/Twist", "sensor_msgs/msg/JointState", "std_msgs/msg/Empty",
    "std_msgs/msg/String", "std_msgs/msg/Bool", "sensor_msgs/msg/Imu",
    "std_msgs/msg/Float32MultiArray", "sensor_msgs/msg/BatteryState",
    "builtin_interfaces/msg/Duration", "diagnostic_msgs/msg/KeyValue",
)  # fmt: skip
DISTROS = ("humble", "jazzy", "kilted", "lyrical", "noetic")
BATCHES = 6


@pytest.mark.timeout(300)
def test_sample() -> None:
    """A sample of types crosses in both directions, with gcc's layout equal to ours."""
    Crossing.of([layout_of(name, "jazzy", LIMITS) for name in SAMPLE], "jazzy").run(seed=1, rounds=20)


@pytest.mark.parametrize(("target", "defined"), [("x86", ()), ("arm", ("pou: MemoryBarrier.MemoryBarrier",))])
def test_processor_width_and_barrier(target: Literal["x86", "arm"], defined: tuple[str, ...]) -> None:
    """Nothing depends on the width of intermediate results or on which fence there is."""
    layouts = [layout_of(name, "jazzy", LIMITS) for name in SAMPLE[:2]]
    crossing = Crossing.of(layouts, "jazzy", ProjectOptions(target=target))
    crossing.run(seed=2, options=Options(cpu_bits=32 if defined else 64, defined=defined))


def all_layouts(distro: str) -> list:  # type: ignore[type-arg]
    """Return the layouts of every bundled message type."""
    return [layout_of(name, distro, LIMITS) for name in store(distro).names()]


@pytest.mark.verify(minutes=0.4)
@pytest.mark.timeout(3600)
@pytest.mark.parametrize("batch", range(BATCHES))
@pytest.mark.parametrize("distro", DISTROS)
def test_all_types(distro: str, batch: int) -> None:
    """Every bundled type crosses in both directions with random values and comes out equal."""
    layouts = all_layouts(distro)[batch::BATCHES]
    assert layouts
    Crossing.of(layouts, distro).run(seed=batch, rounds=3)


@needs_armhf
def test_sample_under_armhf() -> None:
    """The same blocks, compiled for a 32-bit ARM, cross under qemu-user."""
    crossing = Crossing.of([layout_of(name, "jazzy", LIMITS) for name in SAMPLE[:4]], "jazzy")
    crossing.run(seed=3, toolchain=ARMHF, options=Options(cpu_bits=32))
