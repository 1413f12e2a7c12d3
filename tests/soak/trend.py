"""Whether what a process holds grows over its life: a test for a trend, and not a look at two numbers.

Only a process that nobody killed tells anything; a campaign that spares a part lets it live from the first
round to the last. What a program takes while it settles is left out: the first rounds, and for memory the
first half of a life.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

__all__ = ["LEAST_ROUNDS", "Trend", "leaks", "trends"]

LEAST_ROUNDS = 60
"""Rounds of a life from which on it is judged."""
_SETTLED = 10
_MOST_POINTS = 1500
_CERTAIN_Z = 3.3
"""Of Mann and Kendall's test: one life in a thousand without any trend looks like one."""
# What may come over a whole life by itself: descriptors, threads and KiB, and KiB for each round.
_ALLOWED = {"files": (3.0, 0.0), "threads": (3.0, 0.0), "private_kb": (4096.0, 8.0)}


@dataclass(frozen=True)
class Trend:
    """How one quantity of one process went.

    Attributes:
        part: The part of the cell.
        pid: Its process.
        quantity: ``files``, ``threads`` or ``private_kb``.
        rounds: Rounds that were judged.
        begin: The median of their first quarter.
        end: The median of their last quarter.
        slope: Median change per round over all pairs of rounds (Theil and Sen).
        z: How far from chance (Mann and Kendall); above 3.3 it counts as a rise.
    """

    part: str
    pid: int
    quantity: str
    rounds: int
    begin: float
    end: float
    slope: float
    z: float

    @property
    def leak(self) -> bool:
        """Whether it rises, and by more than may come by itself."""
        absolute, per_round = _ALLOWED[self.quantity]
        allowed = max(absolute, per_round * self.rounds)
        return self.z > _CERTAIN_Z and max(self.slope * self.rounds, self.end - self.begin) > allowed


def trends(samples: Sequence[Mapping[str, Any]]) -> list[Trend]:
    """Return the trends of all lives that are long enough.

    Args:
        samples: One for each round, as a campaign's JSON has them.
    """
    lives: dict[tuple[str, int], list[Mapping[str, Any]]] = {}
    for sample in samples:
        for part, usage in sample.items():
            if isinstance(usage, Mapping):
                if part == "bridge":
                    # It holds each object's lock, and reloads change how many there are: two files each.
                    usage = {**usage, "files": usage["files"] - sample.get("objects", 0) / 2}
                lives.setdefault((part, usage["pid"]), []).append(usage)
    return [
        _trend(part, pid, quantity, life)
        for (part, pid), life in lives.items()
        if len(life) >= LEAST_ROUNDS
        for quantity in _ALLOWED
    ]


def leaks(samples: Sequence[Mapping[str, Any]]) -> list[str]:
    """Return in words what grew."""
    return [
        f"{one.part}: {one.quantity} rose from {one.begin:g} to {one.end:g} in {one.rounds} rounds"
        for one in trends(samples)
        if one.leak
    ]


def _trend(part: str, pid: int, quantity: str, life: Sequence[Mapping[str, Any]]) -> Trend:
    skipped = len(life) // 2 if quantity == "private_kb" else _SETTLED
    values = np.array([usage[quantity] for usage in life[skipped:]], dtype=np.float64)
    quarter = max(1, len(values) // 4)
    slope, z = _theil_sen(values)
    return Trend(
        part,
        pid,
        quantity,
        len(values),
        float(np.median(values[:quarter])),
        float(np.median(values[-quarter:])),
        slope,
        z,
    )


def _theil_sen(values: np.ndarray[Any, np.dtype[np.float64]]) -> tuple[float, float]:
    every = -(-len(values) // _MOST_POINTS)
    values = values[::every]
    count = len(values)
    first, second = np.triu_indices(count, 1)
    rises = values[second] - values[first]
    total = float(np.sign(rises).sum())
    _, ties = np.unique(values, return_counts=True)
    variance = (
        count * (count - 1) * (2 * count + 5) - float((ties * (ties - 1) * (2 * ties + 5)).sum())
    ) / 18
    z = 0.0 if total == 0 or variance <= 0 else (total - math.copysign(1, total)) / math.sqrt(variance)
    return float(np.median(rises / (second - first))) / every, z
