"""Paths of numbers in a message, such as ``pose.position.x`` or ``points[3].x``."""

from __future__ import annotations

import re
from functools import lru_cache
from typing import Any

__all__ = ["MAX_PATH", "number_at", "parse_path"]

MAX_PATH = 300
"""Characters of the longest path that is accepted."""

_STEP = re.compile(r"(?:^|\.)([A-Za-z_][A-Za-z0-9_]*)|\[([0-9]{1,8})\]")


@lru_cache(maxsize=1024)
def parse_path(text: str) -> tuple[str | int, ...]:
    """Return the steps of a path: names of fields and indices of elements.

    Raises:
        ValueError: It is no path.
    """
    steps: list[str | int] = []
    at = 0
    while at < len(text) <= MAX_PATH:
        found = _STEP.match(text, at)
        if found is None or found.end() == at:
            break
        steps.append(found[1] if found[2] is None else int(found[2]))
        at = found.end()
    if not steps or at != len(text):
        raise ValueError(f"{text[:80]!r} is no path of a field")
    return tuple(steps)


def number_at(message: Any, path: str) -> float | int | None:
    """Return the number at a path of a message; None if there is none.

    A bool counts as 0 or 1. NaN and infinities are None: they have no place in a plot.
    """
    value = message
    try:
        for step in parse_path(path):
            value = value[step]
    except (LookupError, TypeError):
        return None
    if not isinstance(value, int | float):
        return None
    value = int(value) if isinstance(value, bool) else value
    return value if value - value == 0 else None
