"""Rounds in random order: a fault, the time until all is carried again, the checks."""

from __future__ import annotations

import json
import os
import random
import resource
import shutil
import signal
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass, field, is_dataclass
from pathlib import Path
from typing import Any

from tests.soak.cell import SHM, Cell, WatchdogError
from tests.soak.checks import Checker
from tests.soak.faults import Fault
from tests.soak.messages import ALL, TOPICS
from tests.soak.processes import proc_status
from tests.soak.results import leaks

_TAIL = 1 << 20
_STATUS = ("State", "Threads", "VmSize", "RssAnon")


def keep(cell: Cell, number: int, round_: Any, seed: int, where: Path) -> None:
    """Write the bundle of a round.

    Args:
        cell: The cell, as it stands after the round.
        number: The round's.
        round_: The round, a dataclass.
        seed: The campaign's.
        where: The folder; made if it is missing.
    """
    where.mkdir(parents=True, exist_ok=True)
    for part in cell.parts.values():
        (where / part.log.name).write_text(part.told()[-_TAIL:])
    for path in (cell.config, cell.folder / "counters"):
        with suppress(OSError):
            shutil.copy(path, where / path.name)
    memory = where / "shm"
    memory.mkdir(exist_ok=True)
    for path in SHM.glob(f"*{cell.prefix}*"):
        with suppress(OSError):
            shutil.copy(path, memory / path.name)
    plc = f" --plc {cell.plc}" if cell.plc != "python" else ""
    assert is_dataclass(round_) and not isinstance(round_, type)
    known = {
        "round": asdict(round_),
        "repeat": f"python -m tests.soak --backend {cell.backend}{plc} --seed {seed} "
        f"--from-round {number} --rounds 1",
        "topics": {ALL[index]: _numbers(cell, index) for index in range(len(ALL))},
        "shared memory": sorted(path.name for path in SHM.glob(f"*{cell.prefix}*")),
        "expected": sorted(cell.expected_objects()),
        "processes": {name: _process(part.pid) for name, part in cell.parts.items()},
    }
    (where / "round.json").write_text(json.dumps(known, indent=1) + "\n")


def _numbers(cell: Cell, index: int) -> dict[str, int]:
    counters = cell.counters.counters[index]
    found = {name: int(counters[name]) for name in counters.dtype.names}
    if ALL[index] in TOPICS:
        bridge = cell.counters.bridge[index]
        found |= {f"bridge {name}": int(bridge[name]) for name in bridge.dtype.names}
    return found


def _process(pid: int) -> dict[str, str]:
    try:
        return {name: value for name, value in proc_status(pid).items() if name in _STATUS}
    except OSError:
        return {"State": "ended"}


_MOST_VIOLATIONS = 20
_NOTE_EVERY = 20


@dataclass(frozen=True)
class Round:
    """One round.

    Attributes:
        number: From 1.
        fault: The kind of fault.
        recovery_s: From the end of the fault until a newer message had come through on every topic.
        violations: What did not hold.
        fault_s: How long it took to do it and undo it.
        check_s: How long the checks took.
    """

    number: int
    fault: str
    recovery_s: float
    violations: tuple[str, ...] = ()
    fault_s: float = 0.0
    check_s: float = 0.0


@dataclass
class Outcome:
    """What a campaign found.

    Attributes:
        seed: It, the backend and the number of rounds make the same order of faults again.
        backend: The ROS side.
        plc: The PLC.
        spared: Parts that no fault ends.
        rounds: All rounds.
        skipped: Fault → why it was not tried.
        samples: Per round, what each process held.
        messages: Messages that arrived at either end.
        unaccounted: Messages missing per round in which something died; most were sent while it was away.
        growth_kb: Part → the most that a settled process grew.
        seconds: How long it took.
        cpu_s: Processor time of the cell's processes that have ended, and of the campaign.
        leaks: What grew over a life.
        faults: The kinds that were tried.
    """

    seed: int
    backend: str
    plc: str = "python"
    spared: tuple[str, ...] = ()
    rounds: list[Round] = field(default_factory=list)
    skipped: dict[str, str] = field(default_factory=dict)
    samples: list[dict[str, Any]] = field(default_factory=list)
    messages: int = 0
    unaccounted: list[int] = field(default_factory=list)
    growth_kb: dict[str, int] = field(default_factory=dict)
    seconds: float = 0.0
    cpu_s: float = 0.0
    leaks: list[str] = field(default_factory=list)
    faults: tuple[str, ...] = ()

    @property
    def violations(self) -> list[str]:
        """All that did not hold, each with its round; then what grew over many."""
        found = [f"round {one.number}, {one.fault}: {what}" for one in self.rounds for what in one.violations]
        return found + self.leaks


class Campaign:
    """Runs rounds on a cell.

    Args:
        cell: The cell; it is started by :meth:`run`.
        faults: What may happen.
        seed: Decides what happens when.
        say: Takes a line about each round.
        spared: Parts that no fault ends: noted.
        note: Takes what was found so far, now and then: a campaign of hours must not end with nothing.
    """

    def __init__(
        self,
        cell: Cell,
        faults: Sequence[Fault],
        seed: int,
        say: Callable[[str], None],
        note: Callable[[Outcome], None] = lambda _: None,
        spared: Sequence[str] = (),
    ) -> None:
        self._cell = cell
        self._say = say
        self._note = note
        self._began = 0.0
        self._seed = seed
        self.outcome = Outcome(seed, cell.backend, cell.plc, tuple(spared))
        self._faults = []
        for fault in faults:
            if why := fault.missing(cell):
                self.outcome.skipped[fault.name] = why
            else:
                self._faults.append(fault)
        self.outcome.faults = tuple(fault.name for fault in self._faults)

    def run(self, rounds: int, seconds: float, logs: Path | None = None, first: int = 1) -> Outcome:
        """Run until so many rounds or seconds are over.

        Args:
            rounds: The most rounds; 0: no limit.
            seconds: The most seconds, from when the cell carries; 0: no limit.
            logs: Where the bundle of a round goes in which something did not hold.
            first: Leave out the rounds before this one, to repeat one that failed.
        """
        self._cell.start()
        self._began = time.monotonic()  # a busy machine may take long to start: that is no round's time
        checker = Checker(self._cell)
        try:
            for number, fault, own_dice in self.drawn(first):
                if rounds and len(self.outcome.rounds) >= rounds:
                    break
                if seconds and time.monotonic() - self._began >= seconds:
                    break
                self._one(number, fault, own_dice, checker, logs)
                if len(self.outcome.violations) >= _MOST_VIOLATIONS:
                    self._say("too much does not hold; the campaign ends")
                    break
        finally:
            self._sum_up(checker)
            self.outcome.leaks = leaks(self.outcome.samples)
        return self.outcome

    def drawn(self, first: int = 1) -> Iterator[tuple[int, Fault, random.Random]]:
        """Yield number, fault and dice of each round from ``first`` on, for ever, as the seed has them."""
        dice = random.Random(self._seed)
        number, bag = 0, list[Fault]()
        while True:
            number += 1
            if not bag:
                # Every kind once, in an order of its own each time: rare kinds come as often as others.
                bag = dice.sample(self._faults, len(self._faults))
            fault, own_dice = bag.pop(), random.Random(dice.random())
            # What comes before the first is drawn all the same, so that the rest is drawn as it was.
            if number >= first:
                yield number, fault, own_dice

    def _one(
        self, number: int, fault: Fault, dice: random.Random, checker: Checker, logs: Path | None
    ) -> None:
        one = self._round(number, fault, checker, dice)
        self.outcome.rounds.append(one)
        self._say(
            f"{number:5d}  {one.fault:36s} {one.recovery_s:6.2f} s  {'; '.join(one.violations) or 'ok'}"
        )
        if one.violations:
            if logs is not None:
                keep(self._cell, number, one, self._seed, logs / f"round-{number}")
            self._start_over()
        self._sample(number)
        if number % _NOTE_EVERY == 0:
            self._sum_up(checker)
            self._note(self.outcome)

    def _sum_up(self, checker: Checker) -> None:
        outcome = self.outcome
        outcome.seconds = time.monotonic() - self._began
        outcome.cpu_s = sum(
            sum(resource.getrusage(who)[:2]) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)
        )
        outcome.messages = int(self._cell.counters.counters["received"].sum())
        outcome.unaccounted = checker.unaccounted
        outcome.growth_kb = checker.worst_growth_kb

    def _round(self, number: int, fault: Fault, checker: Checker, dice: random.Random) -> Round:
        cell = self._cell
        recovery = inflicted = checked = 0.0
        try:
            for part in cell.parts.values():
                part.mark()
            checker.begin()
            began = time.monotonic()
            fault.inflict(cell, dice)
            if fault.may_end:
                cell.ensure()
            inflicted = time.monotonic() - began
            recovery = cell.await_flow(cell.marks())
            began = time.monotonic()
            found = checker.end(fault)
            checked = time.monotonic() - began
        except (WatchdogError, AssertionError, OSError) as error:
            found = [f"{type(error).__name__}: {error}"]
        return Round(number, fault.name, recovery, tuple(found), inflicted, checked)

    def _start_over(self) -> None:
        """After a round that did not end well: everything again, so that the next says something again."""
        cell = self._cell
        cell.counters.control["flood"] = 1
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
            cell.await_diagnostics()  # the next round begins with what this bridge counts, not another
        except WatchdogError as error:
            self._say(f"       starting over: {error}")

    def _sample(self, number: int) -> None:
        sample: dict[str, Any] = {
            "round": number,
            "seconds": round(time.monotonic() - self._began, 3),
            "load": round(os.getloadavg()[0], 2),
            "objects": len(list(SHM.glob(f"*{self._cell.prefix}*"))),
        }
        for name, part in self._cell.parts.items():
            usage = part.usage()
            if usage is not None:
                sample[name] = asdict(usage)
        self.outcome.samples.append(sample)
