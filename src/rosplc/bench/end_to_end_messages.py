"""The messages of the end-to-end comparison: everything in one follows from its number.

So whoever receives one, whole or piece by piece, can tell without asking the sender whether all pieces
belong to the same message, and what the way has done to strings and 64-bit numbers.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

__all__ = ["KINDS", "Judgement", "Kind"]

_LIMIT = 50_000  # a float32 still tells numbers below this apart, with the fraction beside them


@dataclass(frozen=True, slots=True)
class Judgement:
    """What a received message says about its way.

    Attributes:
        number: Its number; 0 if it is torn, or nothing has been written yet.
        torn: Whether its pieces belong to different messages.
        error: The largest deviation of a floating-point value from what was sent, in units of that value
            (1e-7: the seventh digit); 0.0 for a torn message.
        strings: Strings that arrived as they were sent.
    """

    number: int
    torn: bool
    error: float = 0.0
    strings: int = 0


@dataclass(frozen=True, slots=True)
class Kind:
    """One message type with what fills it.

    Attributes:
        name: Short, for topics and tables.
        type_name: ``package/msg/Name``.
        paths: Every leaf in the type's order, ``pose.position.x``; an array is one leaf.
        length: Elements of each array; 0 where the type has none.
    """

    name: str
    type_name: str
    paths: tuple[str, ...]
    length: int = 0

    def leaf(self, path: str, number: int) -> Any:
        """Return what message ``number`` holds at ``path``."""
        last = path.rpartition(".")[2]
        if last == "frame_id":
            return f"frame {number}"
        if last == "sec":
            return number
        if last == "nanosec":
            return number * 1000
        if last == "name":
            return [f"joint_{index}" for index in range(self.length)]
        place = self.paths.index(path)
        if self.length:
            return [number + _fraction(place * self.length + index) for index in range(self.length)]
        return number + _fraction(place)

    def leaves(self, number: int) -> list[Any]:
        """Return all leaves of message ``number``, in the order of :attr:`paths`."""
        if not 0 < number < _LIMIT:
            raise ValueError(f"message numbers go from 1 to {_LIMIT - 1}, not {number}")
        return [self.leaf(path, number) for path in self.paths]

    def tree(self, leaves: Sequence[Any]) -> dict[str, Any]:
        """Return leaves as the nested dict that a layout packs."""
        tree: dict[str, Any] = {}
        for path, value in zip(self.paths, leaves, strict=True):
            *parents, last = path.split(".")
            node = tree
            for parent in parents:
                node = node.setdefault(parent, {})
            node[last] = value
        return tree

    def read(self, message: Any) -> list[Any]:
        """Return the leaves of a message (attribute access, as a record view gives it)."""
        leaves = []
        for path in self.paths:
            value = message
            for part in path.split("."):
                value = getattr(value, part)
            leaves.append(value if isinstance(value, (int, float, str)) else list(value))
        return leaves

    def judge(self, leaves: Sequence[Any]) -> Judgement:
        """Say whether leaves belong together, and what they lost; a leaf that was not carried is None."""
        numbers: set[int] = set()
        for path, value in zip(self.paths, leaves, strict=True):
            numbers.update(_numbers(path, value))
        if len(numbers) != 1:
            return Judgement(0, True)
        number = numbers.pop()
        if number == 0:
            return Judgement(0, False)
        error, strings = 0.0, 0
        for path, value in zip(self.paths, leaves, strict=True):
            sent = self.leaf(path, number)
            if isinstance(sent, str) or path == "name":
                strings += _equal_strings(sent, value)
            elif value is not None:
                error = max(error, _error(sent, value))
        return Judgement(number, False, error, strings)

    def strings(self) -> int:
        """Return how many strings a message has."""
        return sum(self.length if path == "name" else path.endswith("frame_id") for path in self.paths)


def _fraction(place: int) -> float:
    """Return a fraction that no float32 holds, different at each place, away from 0 and 1."""
    return 0.1 + 0.8 * ((place * 0.6180339887498949) % 1.0)


def _numbers(path: str, value: Any) -> set[int]:
    """Return the message numbers that a leaf speaks of; empty if it carries none."""
    last = path.rpartition(".")[2]
    if value is None or last == "name":
        return set()
    if last == "frame_id":
        words = value.split()
        return {int(words[1])} if len(words) == 2 else set()
    if last == "sec":
        return {int(value)}
    if last == "nanosec":
        return {int(value) // 1000}
    return {math.floor(item) for item in (value if isinstance(value, (list, tuple)) else (value,))}


def _equal_strings(sent: Any, value: Any) -> int:
    if value is None:
        return 0
    if isinstance(sent, str):
        return int(sent == value)
    return sum(one == other for one, other in zip(sent, value, strict=False))


def _error(sent: Any, value: Any) -> float:
    if isinstance(sent, list):
        if len(sent) != len(value):
            return math.inf
        return max((_error(one, other) for one, other in zip(sent, value, strict=True)), default=0.0)
    return float(abs(value - sent) / abs(sent))


_STAMP = ("header.stamp.sec", "header.stamp.nanosec", "header.frame_id")
_TWIST = tuple(f"{part}.{axis}" for part in ("linear", "angular") for axis in "xyz")
_POSE = (*(f"pose.position.{axis}" for axis in "xyz"), *(f"pose.orientation.{axis}" for axis in "xyzw"))
_JOINTS = (*_STAMP, "name", "position", "velocity", "effort")

KINDS: Mapping[str, Kind] = {
    kind.name: kind
    for kind in (
        Kind("Twist", "geometry_msgs/msg/Twist", _TWIST),
        Kind("PoseStamped", "geometry_msgs/msg/PoseStamped", (*_STAMP, *_POSE)),
        Kind("JointState6", "sensor_msgs/msg/JointState", _JOINTS, 6),
        Kind("JointState24", "sensor_msgs/msg/JointState", _JOINTS, 24),
    )
}
"""The types compared, by name; JointState of an arm, and of a robot with two arms and hands."""
