"""Faults of a PLC whose program is Structured Text: death inside a lock, online change.

The lock of a classic topic is a semaphore that does not know who holds it. A holder that dies is found out by
the time that nothing moves; one that only stands still for less must not be.
"""

from __future__ import annotations

import random
import signal
import time
from pathlib import Path

from rosplc.shm.semaphore import Semaphore
from tests.soak.cell import Cell
from tests.soak.faults import Fault
from tests.soak.pattern import CLASSIC, TOPICS

__all__ = ["PLC_FAULTS"]


def _stand_still_inside(cell: Cell) -> None:
    """Have the PLC stop (SIGSTOP) inside the next lock that it gets."""
    cell.ledger.control["stop_inside"] = 1
    stat = Path(f"/proc/{cell.parts['plc'].pid}/stat")
    cell.wait(
        lambda: stat.read_text().rpartition(")")[2].split()[0] == "T", "the PLC stands still inside a lock"
    )


def _held(cell: Cell, topic: str) -> Semaphore:
    """Take a classic topic's lock, as a third program that shares the memory does."""
    lock = Semaphore(cell.classic_name(topic))
    cell.wait(lock.enter, "a third program gets the lock")
    return lock


class KillInside(Fault):
    """kill -9 of the PLC inside a lock."""

    name = "kill -9 plc inside a lock"
    ends = frozenset({"plc"})
    accounted = TOPICS

    def inflict(self, cell: Cell, dice: random.Random) -> None:
        _stand_still_inside(cell)
        cell.parts["plc"].kill()
        cell.parts["plc"].start()


class KillBridgeInside(Fault):
    """kill -9 of the bridge while a lock is taken and never given back: the semaphore knows no difference."""

    name = "kill -9 bridge, a lock taken"
    ends = frozenset({"bridge"})

    def inflict(self, cell: Cell, dice: random.Random) -> None:
        lock = _held(cell, dice.choice(CLASSIC))
        cell.parts["bridge"].kill()
        cell.parts["bridge"].start()
        lock.close()


class StrangerDies(Fault):
    """A third program takes a lock and is gone."""

    name = "a third program dies inside a lock"
    accounted = TOPICS

    def inflict(self, cell: Cell, dice: random.Random) -> None:
        _held(cell, dice.choice(CLASSIC)).close()


class StopInside(Fault):
    """SIGSTOP of the PLC inside a lock, for less than after what it counts as dead."""

    name = "stop plc inside a lock"
    accounted = TOPICS

    def inflict(self, cell: Cell, dice: random.Random) -> None:
        _stand_still_inside(cell)
        time.sleep(dice.uniform(0.05, 0.8))
        cell.parts["plc"].send(signal.SIGCONT)


class OnlineChange(Fault):
    """An online change moves every instance of the PLC's program."""

    name = "online change"
    accounted = TOPICS

    def inflict(self, cell: Cell, dice: random.Random) -> None:
        for _ in range(dice.randint(1, 3)):
            cell.ledger.control["online_change"] += 1
            before = int(cell.ledger.control["plc_scans"])
            cell.wait(lambda: cell.ledger.control["plc_scans"] > before + 2, "the PLC goes on")  # noqa: B023


PLC_FAULTS: tuple[Fault, ...] = (
    KillInside(), KillBridgeInside(), StrangerDies(), StopInside(), OnlineChange(),
)  # fmt: skip
