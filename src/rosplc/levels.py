"""Words that everything which reports on a channel has in common."""

from __future__ import annotations

import enum


class Level(enum.IntEnum):
    """How things stand; the numbers are those of diagnostic_msgs/msg/DiagnosticStatus."""

    OK = 0
    WARN = 1
    ERROR = 2
    STALE = 3


def format_age(age_ns: int) -> str:
    """Return an age in the precision that a person needs: 0.2 s, 14 s, 3 min, 5 h.

    Coarse on purpose: what does not change then has a text that does not change.
    """
    seconds = age_ns / 1e9
    if seconds < 10:
        return f"{seconds:.1f} s"
    if seconds < 120:
        return f"{seconds // 5 * 5:.0f} s"
    return f"{seconds // 60:.0f} min" if seconds < 7200 else f"{seconds // 3600:.0f} h"
