"""What other nodes are said to do wrong: names are theirs, so texts are bounded and harmless."""

from __future__ import annotations

from collections.abc import Hashable, Iterable

from rosplc.harmless import one_line

__all__ = ["LONGEST_REASON", "MOST_REASONS", "MOST_REMEMBERED", "Said", "listed"]

MOST_REASONS = 8
"""Peers of one topic that a reason tells of; the others are counted."""
LONGEST_REASON = 500
"""Characters about one peer."""
MOST_REMEMBERED = 1000
"""Reasons that a backend remembers to have logged; further ones are not logged."""


def listed(texts: Iterable[str]) -> str:
    """Return what is wrong with several peers as one line, in their order."""
    unique = list(dict.fromkeys(texts))
    shown = [_short(one_line(text)) for text in unique[:MOST_REASONS]]
    if len(unique) > MOST_REASONS:
        shown.append(f"and {len(unique) - MOST_REASONS} more")
    return "; ".join(shown)


def _short(text: str) -> str:
    return text if len(text) <= LONGEST_REASON else f"{text[: LONGEST_REASON - 1]}…"


class Said:
    """What has been logged already; a graph that makes up names fills neither memory nor log."""

    def __init__(self) -> None:
        self._known: set[Hashable] = set()

    def first(self, what: Hashable) -> bool:
        """Return whether this is to be logged now."""
        if what in self._known or len(self._known) >= MOST_REMEMBERED:
            return False
        self._known.add(what)
        return True
