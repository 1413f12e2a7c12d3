"""The experiment's message as a ROS type: 100 unsigned integers of 16 bits."""

from __future__ import annotations

from functools import cache

from rosplc.described import description_of
from rosplc.layout import Layout, Limits, compute_layout
from rosplc.model import TypeStore
from rosplc.shm import Description, Direction

__all__ = ["ANSWER", "QUESTION", "describe", "layout"]

QUESTION, ANSWER = "/question", "/answer"
"""The topics: what A sends to B, the PLC, and what B sends back."""

_TYPE, _DEFINITION = "bench_msgs/msg/Registers", "uint16[100] values\n"


@cache
def layout() -> Layout:
    """Return the record's layout: 200 bytes, the numbers and nothing else."""
    store = TypeStore.bundled("jazzy").with_definition(_TYPE, _DEFINITION)
    return compute_layout(store, _TYPE, Limits())


def describe(topic: str, direction: Direction) -> Description:
    """Return the self-description of one of the two objects."""
    return description_of(layout(), topic, direction, bridge="bench")
