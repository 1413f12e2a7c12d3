"""Counting numbered messages: what arrived, what is missing, what came torn or twice."""

from __future__ import annotations

from dataclasses import asdict, dataclass

__all__ = ["Tally"]


@dataclass(slots=True)
class Tally:
    """What one receiver saw of one topic; numbers start at 1.

    Attributes:
        received: Whole messages with a number that had not been seen.
        missing: Numbers left out so far.
        gaps: How often numbers were left out.
        torn: Messages whose contents do not agree with their seal.
        repeated: Messages with a number at or below the newest one.
        newest: The highest number received.
    """

    received: int = 0
    missing: int = 0
    gaps: int = 0
    torn: int = 0
    repeated: int = 0
    newest: int = 0

    def add(self, number: int, *, whole: bool) -> None:
        """Count one message."""
        if not whole:
            self.torn += 1
        elif number <= self.newest:
            self.repeated += 1
        else:
            self.missing += number - self.newest - 1
            self.gaps += number > self.newest + 1
            self.newest = number
            self.received += 1

    def to_dict(self) -> dict[str, int]:
        """Return the counters as plain data."""
        return asdict(self)
