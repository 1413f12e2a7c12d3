"""All harnesses: what the suite runs over."""

from __future__ import annotations

from tests.conformance.backends.base import Harness
from tests.conformance.backends.dds import DdsHarness
from tests.conformance.backends.memory import MemoryHarness
from tests.conformance.backends.rclpy import RclpyHarness, RclpyHumbleHarness
from tests.conformance.backends.rospy import RospyHarness
from tests.conformance.backends.zenoh import ZenohClientHarness, ZenohHarness

HARNESSES: tuple[type[Harness], ...] = (
    MemoryHarness,
    DdsHarness,
    RclpyHarness,
    RclpyHumbleHarness,
    RospyHarness,
    ZenohHarness,
    ZenohClientHarness,
)
