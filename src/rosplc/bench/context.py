"""What a section gets to measure with: how much effort, which cores, where to put things."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

from rosplc.bench.results import Failure, Skip

__all__ = ["EFFORTS", "Context", "Effort"]


@dataclass(frozen=True)
class Effort:
    """How much is measured.

    Attributes:
        name: "quick", "default" or "full".
        rounds: How often the contenders take turns.
        turn_seconds: About how long one turn of one contender may take.
        slow_rounds: The same in arrangements where a turn is mostly waiting.
        slow_turn_seconds: And about how long such a turn may take.
    """

    name: str
    rounds: int
    turn_seconds: float
    slow_rounds: int
    slow_turn_seconds: float


EFFORTS = {
    effort.name: effort
    for effort in (
        Effort("quick", 1, 0.5, 1, 0.15),
        Effort("default", 3, 3.5, 1, 0.6),
        Effort("full", 7, 6.0, 1, 11.0),
    )
}
"""By name. On a quiet machine with two cores quick takes half a minute, the default two, full twelve."""


def _silent(done: int, total: int, what: str) -> None:
    """Show no progress."""


@dataclass
class Context:
    """The surroundings of one section's run.

    Attributes:
        effort: How much to measure.
        scratch: A folder of this run in /dev/shm, for objects; it is gone at the end.
        cache: Where compiled programs are kept.
        cores: The processor cores that this process may use, two at most: for A and for B.
        only: Names of contenders; empty for all.
        notify: Called with steps done, steps in all, and what is being measured.
    """

    effort: Effort
    scratch: Path
    cache: Path
    cores: tuple[int, ...]
    only: tuple[str, ...] = ()
    notify: Callable[[int, int, str], None] = _silent
    skips: list[Skip] = field(default_factory=list)
    failures: list[Failure] = field(default_factory=list)

    def wants(self, contender: str) -> bool:
        """Return whether a contender is to be measured."""
        return not self.only or contender in self.only

    def skip(self, what: str, reason: str, remedy: str = "") -> None:
        """Note what cannot be measured here; the same thing counts once."""
        found = Skip(what, reason, remedy)
        if found not in self.skips:
            self.skips.append(found)

    def fail(self, what: str, reason: str) -> None:
        """Note what went wrong; the run goes on and ends as not good."""
        self.failures.append(Failure(what, reason))
