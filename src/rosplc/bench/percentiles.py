"""Percentiles of what was measured, never between two values and never beyond the largest."""

from __future__ import annotations

import math
from collections.abc import Sequence

__all__ = ["percentile"]


def percentile(ordered: Sequence[float], percent: float) -> float:
    """Return the value that ``percent`` of the values do not exceed; ``ordered`` ascends and is not empty."""
    return ordered[max(0, math.ceil(len(ordered) * percent / 100) - 1)]
