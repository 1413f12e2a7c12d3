"""Messages that tell by themselves whether they are whole, and who sent them as which.

A ``std_msgs/msg/UInt32MultiArray`` holds generation, number and then words that follow from both and
from the topic: a word of another message, or at another place, is found.
"""

from __future__ import annotations

import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from rosplc.codec import Codec
from rosplc.layout import Limits, compute_layout
from rosplc.model import TypeStore

TYPE = "std_msgs/msg/UInt32MultiArray"
IN = ("/soak/in", "/soak/in_newest")
OUT = ("/soak/out", "/soak/out_newest")
TOPICS = (*IN, *OUT)
"""The topics of every cell, carried over channels; the first of each direction counts every message."""
CLASSIC = ("/soak/classic_in", "/soak/classic_out")
"""In cells with classic topics: a bare record under a semaphore, of which the newest alone is carried."""
ALL = (*TOPICS, *CLASSIC)
"""A topic's place in here is its number in patterns and in the counters."""
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
    return Codec(layout)


GENERATIONS = 1 << 16
_COUNTERS = ("received", "missing", "torn", "invented", "disordered", "generation", "number", "block_lost")
_CONTROL = (
    *("flood", "diagnostics", "stamp_ns", "plc_scans", "publisher_turns", "publisher_clock_ns"),
    *("stop_inside", "online_change", "reopen"),
)
_BRIDGE = ("received", "published", "skipped", "lost", "refused")


class Counters:
    """What was sent and received, by whom and as which.

    Each number is written by one process and read by the campaign.

    Args:
        path: The file.
        create: Make it, zeroed.

    Attributes:
        announced: ``[generation, topic]``: the highest number that a sender was about to send.
        seen: ``[generation, topic]``: the highest number that arrived.
        counters: Per topic, at the receiving end.
        bridge: Per topic, what ``/diagnostics`` says.
        control: Orders and signs of life.
    """

    def __init__(self, path: Path, *, create: bool = False) -> None:
        kind = np.dtype(
            [
                ("announced", np.uint32, (GENERATIONS, len(ALL))),
                ("seen", np.uint32, (GENERATIONS, len(ALL))),
                ("counters", [(name, np.int64) for name in _COUNTERS], (len(ALL),)),
                ("bridge", [(name, np.int64) for name in _BRIDGE], (len(TOPICS),)),
                (
                    "control",
                    [*((name, np.int64) for name in _CONTROL), ("dropped", np.int64, (len(TOPICS),))],
                ),
            ]
        )
        self._map: Any = np.memmap(path, kind, "w+" if create else "r+", shape=(1,))
        self.announced: npt.NDArray[np.uint32] = self._map["announced"][0]
        self.seen: npt.NDArray[np.uint32] = self._map["seen"][0]
        self.counters: Any = self._map["counters"][0]
        self.bridge: Any = self._map["bridge"][0]
        self.control: Any = self._map["control"][0]

    def announce(self, topic: int, generation: int, number: int) -> None:
        """Note that a message is about to be sent: before it is, so that no crash comes between."""
        self.announced[generation, topic] = number

    def take(self, topic: int, data: Any) -> None:
        """Judge a message that arrived, and count it."""
        count = self.counters[topic]
        count["received"] += 1
        stamp = read(topic, data)
        if stamp is None:
            self._wrong("torn", topic, f"{len(data)} words: {list(data[:4])} …")
            return
        if not self._was_sent(topic, stamp):
            self._wrong("invented", topic, str(stamp))
            return
        before = int(self.seen[stamp.generation, topic])
        if stamp.number <= before:
            self._wrong("disordered", topic, f"{stamp} after {before}")
            return
        if before:
            count["missing"] += stamp.number - before - 1
        self.seen[stamp.generation, topic] = stamp.number
        count["generation"], count["number"] = stamp.generation, stamp.number

    def _wrong(self, kind: str, topic: int, what: str) -> None:
        self.counters[topic][kind] += 1
        print(f"{time.time():.3f} {ALL[topic]}: {kind}: {what}", flush=True)

    def _was_sent(self, topic: int, stamp: Stamp) -> bool:
        if not 0 < stamp.generation < GENERATIONS:
            return False
        return 0 < stamp.number <= int(self.announced[stamp.generation, topic])

    def arrived(self, topic: int) -> tuple[int, int]:
        """Return generation and number of the newest message that arrived."""
        count = self.counters[topic]
        return int(count["generation"]), int(count["number"])

    def violations(self) -> dict[str, int]:
        """Return how many messages were torn, invented, or came twice or in another order."""
        return {kind: int(self.counters[kind].sum()) for kind in ("torn", "invented", "disordered")}

    def losses(self) -> list[tuple[int, int]]:
        """Return per topic of TOPICS what is missing at the receiving end, and what somebody has counted."""
        found = []
        for topic in range(len(TOPICS)):
            count, bridge = self.counters[topic], self.bridge[topic]
            counted = int(bridge["lost"] + bridge["refused"] + bridge["skipped"])
            # The PLC counts what the bridge overwrote before it looked, the ROS side what it dropped.
            counted += int(count["block_lost"] if topic < len(IN) else self.control["dropped"][topic])
            found.append((int(count["missing"]), counted))
        return found
