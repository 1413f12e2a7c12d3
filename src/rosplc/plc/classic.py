"""Classic topics: a bare record under a named semaphore, as the source thesis has it.

Their blocks are used like the others: programs see ``msg``, ``xValid``, ``xNew``, ``xStale`` or ``xEnable``.
"""

from __future__ import annotations

from dataclasses import dataclass

from rosplc.errors import GenerationError
from rosplc.plc.literals import string_literal

__all__ = ["LIBRARY", "LONGEST_NAME", "Classic", "check_classic", "classic_arguments", "classic_wait"]

LIBRARY = "SysSemProcess"
LONGEST_NAME = 80  # characters: SysShm and SysSemProcess take a STRING


@dataclass(frozen=True)
class Classic:
    """Where a classic topic lies.

    Attributes:
        name: The shared memory's name, without a slash.
        semaphore: The semaphore's; empty if nothing guards the memory.
        wait_ns: How long an access waits for the lock at most.
    """

    name: str
    semaphore: str
    wait_ns: int = 2_000_000


def check_classic(topic: str, classic: Classic) -> None:
    """Raise what makes a name impossible: GenerationError PLC007."""
    for name in (classic.name, classic.semaphore):
        plain = all("!" <= char <= "~" and char != "/" for char in name)
        if len(name) > LONGEST_NAME or not plain or not classic.name:
            raise GenerationError("PLC007", f"{name!r} is none", where=topic)


def classic_arguments(classic: Classic) -> tuple[tuple[str, str], ...]:
    """Return FB_Init's arguments."""
    return (("sMemory", string_literal(classic.name)), ("sSemaphore", string_literal(classic.semaphore)))


def classic_wait(classic: Classic, cycle_ns: int) -> int:
    """Return how long a block may wait for the lock, in ms: never more than half of its task's cycle.

    Args:
        classic: The topic.
        cycle_ns: The task's interval; 0 if it has none.
    """
    wait = -(-classic.wait_ns // 1_000_000)
    return min(wait, cycle_ns // 2_000_000) if cycle_ns else wait
