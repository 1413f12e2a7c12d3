"""How the two processes stand on the machine, and how whoever waits does so.

The waiting strategy decides a figure more than what lies underneath, so each is measured apart
and stands with every table.
"""

from __future__ import annotations

from dataclasses import dataclass

__all__ = [
    "ARRANGEMENTS",
    "CYCLIC",
    "ONE_CORE",
    "ONE_CORE_BUSY",
    "ONE_CORE_CYCLE",
    "ONE_CORE_YIELD",
    "TWO_CORES",
    "TWO_CORES_BLOCKING",
    "WAITING",
    "Arrangement",
    "Way",
]


@dataclass(frozen=True)
class Arrangement:
    """Where the processes run.

    Attributes:
        name: In the report's JSON.
        title: In headings.
        cores: How many cores the two processes use.
        period_ns: The period of both programs; 0 if they are not cyclic.
        waiting: How one waits in it, for the line below every table.
        slow: Whether a turn is mostly waiting, whoever measures: fewer and shorter turns do.
    """

    name: str
    title: str
    cores: int
    period_ns: int
    waiting: str
    slow: bool = False


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
_SHARED = "both processes share one core; the column says what whoever waits does meanwhile"
ONE_CORE_BUSY = Arrangement("one-core-busy", "One core, looking again at once", 1, 0, _SHARED, True)
ONE_CORE_YIELD = Arrangement("one-core-yield", "One core, giving it away between two looks", 1, 0, _SHARED)
ONE_CORE_CYCLE = Arrangement(
    "one-core-cycle", "One core, looking every millisecond", 1, 1_000_000, _SHARED, True
)
TWO_CORES_BLOCKING = Arrangement(
    "two-cores-blocking",
    "Two cores, blocking",
    2,
    0,
    "each process has a core of its own and sleeps until it is woken",
)
_CYCLE = (
    "both programs are cyclic and look once per period, B half a period after A; each has a core of its own "
    "where there are two"
)
CYCLIC = (
    Arrangement("cycle-1ms", "Polling in a cycle of 1 ms", 2, 1_000_000, _CYCLE, True),
    Arrangement("cycle-10ms", "Polling in a cycle of 10 ms", 2, 10_000_000, _CYCLE, True),
)
ARRANGEMENTS = (TWO_CORES, ONE_CORE, *CYCLIC)
"""Those of the experiment, in the order of the report."""

WAITING = (ONE_CORE_BUSY, ONE_CORE_YIELD, ONE_CORE_CYCLE, ONE_CORE, TWO_CORES_BLOCKING)
"""Those that show what waiting alone does."""
