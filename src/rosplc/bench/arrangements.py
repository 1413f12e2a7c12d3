"""How the two processes stand on the machine, and how whoever waits does so.

The waiting strategy decides a figure more than what lies underneath, so each is measured apart
and stands with every table.
"""

from __future__ import annotations

from dataclasses import dataclass

__all__ = ["ARRANGEMENTS", "CYCLIC", "ONE_CORE", "ONE_CORE_BUSY", "TWO_CORES", "Arrangement", "Way"]


@dataclass(frozen=True)
class Arrangement:
    """Where the processes run.

    Attributes:
        name: In the report's JSON.
        title: In headings.
        cores: How many cores the two processes use.
        period_ns: The period of both programs; 0 if they are not cyclic.
        waiting: How one waits in it, for the line below every table.
    """

    name: str
    title: str
    cores: int
    period_ns: int
    waiting: str


@dataclass(frozen=True)
class Way:
    """How one contender waits in an arrangement.

    Attributes:
        order: What its processes are told: spin, yield, block or cycle.
        words: The same for people.
    """

    order: str
    words: str


TWO_CORES = Arrangement(
    "two-cores",
    "Two cores, spinning",
    2,
    0,
    "each process has a core of its own and looks again at once (spins) where the contender allows it; "
    "the column says who blocks instead",
)
ONE_CORE = Arrangement(
    "one-core",
    "One core, blocking",
    1,
    0,
    "both processes share one core, as on the source's board, and sleep until they are woken",
)
ONE_CORE_BUSY = Arrangement(
    "one-core-busy",
    "One core, busy",
    1,
    0,
    "both processes share one core, and whoever waits keeps looking; the column says how",
)
_CYCLE = (
    "both programs are cyclic and look once per period, B half a period after A; each has a core of its own "
    "where there are two"
)
CYCLIC = (
    Arrangement("cycle-1ms", "Polling in a cycle of 1 ms", 2, 1_000_000, _CYCLE),
    Arrangement("cycle-10ms", "Polling in a cycle of 10 ms", 2, 10_000_000, _CYCLE),
)
ARRANGEMENTS = (TWO_CORES, ONE_CORE, *CYCLIC)
"""Those of the experiment, in the order of the report."""
