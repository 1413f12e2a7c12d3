"""All harnesses: what the suite runs over."""

from __future__ import annotations

from tests.conformance.backends.base import Harness
from tests.conformance.backends.dds import DdsHarness
from tests.conformance.backends.memory import MemoryHarness

HARNESSES: tuple[type[Harness], ...] = (MemoryHarness, DdsHarness)
