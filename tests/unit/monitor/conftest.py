"""Channels to look at, and a clock that the test sets."""

from __future__ import annotations

import pytest

from rosplc.monitor import Watch
from rosplc.shm import Direction, attach
from tests.channels import Side, layout_of
from tests.lib.clock import SteppedClock


class Cell:
    """Channels of one bridge, and a watch over them."""

    def __init__(self, namespace):
        self.namespace = namespace
        self.clock = SteppedClock()
        self.sides: list[Side] = []
        self.attached = []
        self.watches = []

    def side(self, topic, type_name="std_msgs/msg/Float64", direction=Direction.TO_PLC, **limits):
        made = Side(self.namespace, topic, layout_of(type_name, **limits), direction, bridge="cell")
        self.sides.append(made)
        return made

    def watch(self, **settings):
        made = Watch(self.namespace.prefix, clock=self.clock, **settings)
        self.watches.append(made)
        return made

    def plc_reader(self, topic, task="PLC_PRG", beat_ms=100):
        attached = attach(self.namespace, topic, write=True)
        self.attached.append(attached)
        return attached.reader(task, observe=False, beat_ms=beat_ms)

    def plc_writer(self, topic, beat_ms=100):
        attached = attach(self.namespace, topic, write=True)
        self.attached.append(attached)
        return attached.writer(beat_ms=beat_ms)

    def pass_time(self, seconds):
        self.clock.advance(seconds)

    def close(self):
        for each in (*self.watches, *self.attached, *self.sides):
            each.close()


@pytest.fixture
def cell(shm_namespace):
    made = Cell(shm_namespace)
    yield made
    made.close()
