"""Look things up in what an experiment measured, by arrangement and contender."""

from __future__ import annotations

import statistics
from collections.abc import Iterator, Mapping
from typing import Any

from rosplc.bench.stats import median_ratio

__all__ = ["Found", "durations", "group_of"]


class Found:
    """The data of :func:`rosplc.bench.turns.take_turns`.

    Args:
        arrangements: Its list.
    """

    def __init__(self, arrangements: list[Mapping[str, Any]]) -> None:
        self._arrangements = {each["name"]: each for each in arrangements}

    def __iter__(self) -> Iterator[Mapping[str, Any]]:
        return iter(self._arrangements.values())

    def entries(self, arrangement: str) -> dict[str, Mapping[str, Any]]:
        """Return the contenders of an arrangement by name; none if it was not measured."""
        found = self._arrangements.get(arrangement)
        return {} if found is None else {each["name"]: each for each in found["contenders"]}

    def values(self, arrangement: str, contender: str, key: str) -> list[float]:
        """Return a key's value of each round; none if it was not measured."""
        entry = self.entries(arrangement).get(contender)
        return [] if entry is None else [each[key] for each in entry["rounds"]]

    def ratio(self, arrangement: str, slower: str, faster: str, key: str = "run_us") -> float | None:
        """Return the median over the rounds of ``slower`` divided by ``faster``; None without both."""
        these = self.values(arrangement, slower, key)
        those = self.values(arrangement, faster, key)
        return median_ratio(these, those) if these and those else None

    def median(self, arrangement: str, contender: str, key: str = "run_us") -> float | None:
        """Return the median of the rounds; None if it was not measured."""
        values = self.values(arrangement, contender, key)
        return statistics.median(values) if values else None


def group_of(title: str) -> str:
    """Return the group of a series: whose figure it is."""
    return next((group for group in ("source:", "rosplc") if title.startswith(group)), "").rstrip(":")


def durations(entry: Mapping[str, Any]) -> dict[int, float]:
    """Return the median of the rounds' durations in seconds, by number of cycles."""
    gathered: dict[int, list[float]] = {}
    for each in entry["rounds"]:
        for count, seconds in each["durations_s"].items():
            gathered.setdefault(int(count), []).append(seconds)
    return {count: statistics.median(values) for count, values in gathered.items()}
