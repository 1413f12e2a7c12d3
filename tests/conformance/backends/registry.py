"""All harnesses: what the suite runs over."""

from __future__ import annotations

from tests.conformance.backends.base import Harness
from tests.conformance.backends.dds import DdsHarness
from tests.conformance.backends.memory import MemoryHarness
from tests.conformance.backends.rclpy import RclpyHarness
from tests.conformance.backends.rospy import RospyHarness

HARNESSES: tuple[type[Harness], ...] = (MemoryHarness, DdsHarness, RclpyHarness, RospyHarness)
