"""Messages that tell by themselves whether they are whole, and who sent them as which.

A ``std_msgs/msg/UInt32MultiArray`` holds generation, number and then words that follow from both and
from the topic: a word of another message, or at another place, is found.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from rosplc.codec import Codec, Wire
from rosplc.layout import Limits, compute_layout
from rosplc.model import TypeStore

__all__ = [
    "ALL", "CAPACITY", "CLASSIC", "IN", "OUT", "ROS_DEPTH", "TOPICS", "TYPE", "Stamp", "fill", "read",
    "towards_plc", "wire_codec",
]  # fmt: skip

TYPE = "std_msgs/msg/UInt32MultiArray"
IN = ("/soak/in", "/soak/in_newest")
OUT = ("/soak/out", "/soak/out_newest")
TOPICS = (*IN, *OUT)
"""The topics of every cell, carried over channels; the first of each direction counts every message."""
CLASSIC = ("/soak/classic_in", "/soak/classic_out")
"""In cells with classic topics: a bare record under a semaphore, of which the newest alone is carried."""
ALL = (*TOPICS, *CLASSIC)
"""A topic's place in here is its number in patterns and in the ledger."""
CAPACITY = 256
ROS_DEPTH = 20_000
"""Messages that wait in ROS. DDS counts none that it overwrites, so its history must outlast a flood."""
_LONGEST, _SHORTEST = 240, 8
_STEP = np.arange(CAPACITY + 64, dtype=np.uint32) * np.uint32(0x9E3779B1)

Words = npt.NDArray[np.uint32]


@dataclass(frozen=True)
class Stamp:
    """Who sent a message as which.

    Attributes:
        generation: The sender's process, numbered through the campaign.
        number: The message, from 1.
    """

    generation: int
    number: int


def towards_plc(topic: str) -> bool:
    """Return whether a topic goes from ROS to the PLC."""
    return topic in (*IN, CLASSIC[0])


def fill(topic: int, generation: int, number: int) -> Words:
    """Return a message's words."""
    # Lengths change from message to message, so that a count of one with words of another shows.
    length = _SHORTEST + (number * 37 + generation) % (_LONGEST - _SHORTEST)
    base = ((topic + 1) * 0x85EBCA6B ^ generation * 0xC2B2AE35 ^ number * 0x27D4EB2F) & 0xFFFFFFFF
    words: Words = _STEP[:length] + np.uint32(base)
    words[0], words[1] = generation, number
    return words


def read(topic: int, data: Any) -> Stamp | None:
    """Return who sent a message; None if it is not exactly what was sent."""
    words = np.asarray(data, dtype=np.uint32)
    if len(words) < _SHORTEST:
        return None
    stamp = Stamp(int(words[0]), int(words[1]))
    return stamp if np.array_equal(words, fill(topic, stamp.generation, stamp.number)) else None


def wire_codec(store: TypeStore) -> Codec:
    """Return what ROS peers convert the messages with."""
    layout = compute_layout(store, TYPE, Limits(fields={"data": CAPACITY + 64}))
    return Codec(layout, Wire.ROS1 if store.ros_version == 1 else Wire.CDR)
