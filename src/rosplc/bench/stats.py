"""Medians, percentiles and ratios of values measured in turns."""

from __future__ import annotations

import statistics
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

__all__ = ["ENOUGH", "PERCENTILES", "distribution", "median_ratio", "shown"]

PERCENTILES = {"p50": 500, "p99": 990, "p999": 999}
"""Name and thousandths."""

ENOUGH = {"p50": 1, "p99": 100, "p999": 1000}
"""So many values a percentile needs to be anything but the largest."""


def shown(found: Mapping[str, Any], name: str) -> float | None:
    """Return a percentile of a :func:`distribution`; None if there are too few values for it."""
    return float(found[f"{name}_us"]) if found["count"] >= ENOUGH[name] else None


def distribution(spent_ns: Sequence[int]) -> dict[str, Any]:
    """Return count, p50, p99, p99.9 and max of times in nanoseconds, as microseconds.

    A percentile is a value that was measured (the smallest that so many do not exceed), never
    one between two.
    """
    values = np.sort(np.asarray(spent_ns, dtype=np.float64)) / 1000
    # The rank in whole numbers: 0.999 x 1000 in binary fractions is more than 999.
    ranks = {name: -(-values.size * share // 1000) for name, share in PERCENTILES.items()}
    found = {f"{name}_us": float(values[rank - 1]) for name, rank in ranks.items()}
    return {"count": int(values.size), **found, "max_us": float(values[-1])}


def median_ratio(these: Sequence[float], those: Sequence[float]) -> float:
    """Return the median of the ratios of values of the same round.

    Rounds that only one of the two has are left out. Raises statistics.StatisticsError if there is none.
    """
    return statistics.median(a / b for a, b in zip(these, those, strict=False))
