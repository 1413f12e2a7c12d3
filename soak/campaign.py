"""Rounds in random order: a fault, the time until all is carried again, the checks."""

from __future__ import annotations

import random
import signal
import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

from soak.cell import Cell, WatchdogError
from soak.checks import Checker
from soak.faults import Fault

__all__ = ["Campaign", "Outcome", "Round"]

_MOST_VIOLATIONS = 20


@dataclass(frozen=True)
class Round:
    """One round.

    Attributes:
        number: From 1.
        fault: The kind of fault.
        recovery_s: From the end of the fault until a newer message had come through on every topic.
        violations: What did not hold.
    """

    number: int
    fault: str
    recovery_s: float
    violations: tuple[str, ...] = ()


@dataclass
class Outcome:
    """What a campaign found.

    Attributes:
        seed: It, the backend and the number of rounds make the same order of faults again.
        backend: The ROS side.
        rounds: All rounds.
        skipped: Fault → why it was not tried.
        samples: Per round, what each process held.
        messages: Messages that arrived at either end.
        unaccounted: Messages missing per round in which something died; most were sent while it was away.
        growth_kb: Part → the most that a settled process grew.
        seconds: How long it took.
        faults: The kinds that were tried.
    """

    seed: int
    backend: str
    rounds: list[Round] = field(default_factory=list)
    skipped: dict[str, str] = field(default_factory=dict)
    samples: list[dict[str, Any]] = field(default_factory=list)
    messages: int = 0
    unaccounted: list[int] = field(default_factory=list)
    growth_kb: dict[str, int] = field(default_factory=dict)
    seconds: float = 0.0
    faults: tuple[str, ...] = ()

    @property
    def violations(self) -> list[str]:
        """All that did not hold, each with its round."""
        return [f"round {one.number}, {one.fault}: {what}" for one in self.rounds for what in one.violations]


class Campaign:
    """Runs rounds on a cell.

    Args:
        cell: The cell; it is started by :meth:`run`.
        faults: What may happen.
        seed: Decides what happens when.
        say: Takes a line about each round.
    """

    def __init__(self, cell: Cell, faults: Sequence[Fault], seed: int, say: Callable[[str], None]) -> None:
        self._cell = cell
        self._say = say
        self._seed = seed
        self.outcome = Outcome(seed, cell.backend)
        self._faults = []
        for fault in faults:
            if why := fault.missing(cell):
                self.outcome.skipped[fault.name] = why
            else:
                self._faults.append(fault)
        self.outcome.faults = tuple(fault.name for fault in self._faults)

    def run(self, rounds: int, seconds: float, logs: Path | None = None) -> Outcome:
        """Run until so many rounds or seconds are over.

        Args:
            rounds: The most rounds; 0: no limit.
            seconds: The most seconds; 0: no limit.
            logs: Where the processes' logs go if something did not hold.
        """
        cell, outcome = self._cell, self.outcome
        began = time.monotonic()
        dice = random.Random(self._seed)
        cell.start()
        checker = Checker(cell)
        number = 0
        bag: list[Fault] = []
        while (not rounds or number < rounds) and (not seconds or time.monotonic() - began < seconds):
            number += 1
            if not bag:
                # Every kind once, in an order of its own each time: rare kinds come as often as others.
                bag = dice.sample(self._faults, len(self._faults))
            one = self._round(number, bag.pop(), checker, random.Random(dice.random()))
            outcome.rounds.append(one)
            self._sample(number, began)
            text = "; ".join(one.violations) or "ok"
            self._say(f"{number:5d}  {one.fault:30s} {one.recovery_s:6.2f} s  {text}")
            if one.violations and logs is not None:
                cell.keep_logs(logs / f"round-{number}")
            if len(outcome.violations) >= _MOST_VIOLATIONS:
                self._say("too much does not hold; the campaign ends")
                break
        outcome.seconds = time.monotonic() - began
        outcome.messages = int(cell.ledger.counters["received"].sum())
        outcome.unaccounted = checker.unaccounted
        outcome.growth_kb = checker.worst_growth_kb
        return outcome

    def _round(self, number: int, fault: Fault, checker: Checker, dice: random.Random) -> Round:
        cell = self._cell
        recovery = 0.0
        try:
            checker.begin()
            fault.inflict(cell, dice)
            if fault.may_end:
                cell.ensure()
            recovery = cell.await_flow(cell.marks())
            found = checker.end(fault)
        except (WatchdogError, AssertionError, OSError) as error:
            found = [f"{type(error).__name__}: {error}"]
            self._start_over()
        return Round(number, fault.name, recovery, tuple(found))

    def _start_over(self) -> None:
        """After a round that did not end well: everything anew, so that the next says something again."""
        cell = self._cell
        cell.ledger.control["flood"] = 1
        for part in cell.parts.values():
            part.send(signal.SIGCONT)
            part.send(signal.SIGABRT)  # the log then tells where each thread was
        time.sleep(0.5)
        for part in cell.parts.values():
            part.kill()
        cell.write_config()
        cell.ensure()
        try:
            cell.await_flow(cell.marks())
        except WatchdogError as error:
            self._say(f"       starting over: {error}")

    def _sample(self, number: int, began: float) -> None:
        sample: dict[str, Any] = {"round": number, "seconds": round(time.monotonic() - began, 3)}
        for name, part in self._cell.parts.items():
            usage = part.usage()
            if usage is not None:
                sample[name] = asdict(usage)
        self.outcome.samples.append(sample)
