"""The bridge's side of a channel, made by hand."""

from __future__ import annotations

import pytest

from rosplc.shm import Direction
from rosplc.virtual_plc.task import Scan, enter_scan
from tests.channels import Side, layout_of


@pytest.fixture
def side(shm_namespace):
    """Make bridge sides: ``side("/t", "std_msgs/msg/Int32", Direction.TO_PLC)``."""
    sides = []

    def make(topic: str, type_name: str, direction: Direction, *, slots: int = 4, **limits) -> Side:
        sides.append(Side(shm_namespace, topic, layout_of(type_name, **limits), direction, slots))
        return sides[-1]

    yield make
    for each in sides:
        each.close()


class Scans:
    """Runs one block per scan at times that the test chooses."""

    def __init__(self):
        self.now, self.number = 1_000_000_000, 0

    def __call__(self, *blocks, ms: int = 10) -> None:
        self.now += ms * 1_000_000
        self.number += 1
        enter_scan(Scan("Test", self.number, self.now))
        try:
            for block in blocks:
                block()
        finally:
            enter_scan(None)


@pytest.fixture
def scans():
    return Scans()
