"""What must hold after each round.

========== =========================================================================================
torn       no message arrived, at the PLC or in ROS, that was not exactly what was sent
invented   none that nobody had announced to send
disordered none twice, none after a later one of the same sender
losses     on the topics that a fault leaves accountable: what is missing at the receiving end is at
           most what bridge, PLC and subscriber have counted meanwhile
objects    shared memory holds the objects of the configuration and nothing else
resources  a process that lived through the round holds about as many descriptors and threads as
           before, and its own memory does not grow from round to round
========== =========================================================================================
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

from tests.soak.cell import SHM, Cell, WatchdogError
from tests.soak.faults import Fault
from tests.soak.messages import IN, TOPICS
from tests.soak.processes import Usage

# Who counts what is lost on the way to the PLC, and to ROS. Counters begin again with their process.
_COUNTERS = {True: {"bridge", "plc"}, False: {"bridge", "subscriber"}}
_FILES, _THREADS = 12, 8
_SETTLED = 5
_QUANTITIES = ("files", "threads", "private_kb")
_GROWTH_KB = 32 * 1024


@dataclass
class _Life:
    """One process through the rounds, and the most that it held while it settled."""

    pid: int
    rounds: int = 0
    settled: Usage | None = None

    def settle(self, usage: Usage) -> Usage:
        """Take in what it holds now; return what it is compared with."""
        self.rounds += 1
        before = self.settled
        if before is None:
            self.settled = usage
        elif self.rounds <= _SETTLED:
            # A process that has just been started may not have opened anything yet.
            most = {name: max(getattr(before, name), getattr(usage, name)) for name in _QUANTITIES}
            self.settled = replace(before, **most)
        assert self.settled is not None
        return self.settled


@dataclass
class Checker:
    """Judges a cell after each round.

    Attributes:
        cell: The cell.
        worst_growth_kb: Part → the most that one of its processes grew, once it had settled.
        unaccounted: What is missing, per round in which something died.
    """

    cell: Cell
    worst_growth_kb: dict[str, int] = field(default_factory=dict)
    unaccounted: list[int] = field(default_factory=list)
    _lives: dict[str, _Life] = field(default_factory=dict)
    _before: list[tuple[int, int]] = field(default_factory=list)
    _pids: dict[str, int] = field(default_factory=dict)
    _wrong: dict[str, int] = field(default_factory=dict)

    def begin(self) -> None:
        """Note how things stand before a round."""
        # The other way round than at the end: what is counted lags, and must not cover what came before. What
        # was counted shows as missing when the next message has come, and not earlier.
        counted = [known for _, known in self.cell.counters.losses()]
        self.cell.await_flow(self.cell.marks())
        missing = [lost for lost, _ in self.cell.counters.losses()]
        self._before = list(zip(missing, counted, strict=True))
        self._pids = self._processes()

    def _processes(self) -> dict[str, int]:
        return {name: part.pid for name, part in self.cell.parts.items()}

    def _losses(self) -> list[tuple[int, int]]:
        # What is missing is read first and what is counted later, so that nothing is counted too late.
        missing = [lost for lost, _ in self.cell.counters.losses()]
        self.cell.await_diagnostics()
        return [
            (lost, counted) for lost, (_, counted) in zip(missing, self.cell.counters.losses(), strict=True)
        ]

    def end(self, fault: Fault) -> list[str]:
        """Return what does not hold after a round."""
        cell = self.cell
        found = []
        if dead := [name for name, part in cell.parts.items() if not part.alive]:
            found.append(f"{', '.join(dead)} ended though nobody killed it")
            cell.ensure()
        for kind, count in cell.counters.violations().items():
            if count > self._wrong.get(kind, 0):
                found.append(f"{count - self._wrong.get(kind, 0)} messages {kind}")
            self._wrong[kind] = count
        found += self._account(fault)
        found += self._objects()
        found += self._resources()
        return found

    def _account(self, fault: Fault) -> list[str]:
        after = self._losses()
        lost = [now[0] - was[0] for was, now in zip(self._before, after, strict=True)]
        counted = [now[1] - was[1] for was, now in zip(self._before, after, strict=True)]
        now = self._processes()
        replaced = {name for name, pid in now.items() if pid != self._pids[name]}
        if replaced:
            self.unaccounted.append(sum(lost))
        return [
            f"{topic}: {missing} messages are missing, and {known} were counted"
            for topic, missing, known in zip(TOPICS, lost, counted, strict=True)
            if missing > known and topic in fault.accounted and not replaced & self._counting(topic)
        ]

    def _counting(self, topic: str) -> set[str]:
        """Return the parts whose death leaves what is lost on a topic's way uncounted."""
        # A router has messages under way; a master has none.
        hub = {"hub"} if self.cell.backend == "zenoh" else set()
        return _COUNTERS[topic in IN] | hub

    def _objects(self) -> list[str]:
        cell = self.cell
        try:
            cell.wait(lambda: cell.objects() == cell.expected_objects(), "objects")
        except WatchdogError:
            surplus = cell.objects() - cell.expected_objects()
            lacking = cell.expected_objects() - cell.objects()
            return [f"shared memory: {sorted(surplus)} too many, {sorted(lacking)} too few"]
        if cell.private:
            strange = [path.name for path in SHM.iterdir() if cell.prefix not in path.name]
            return [f"shared memory: {strange} left behind"] if strange else []
        return []

    def _resources(self) -> list[str]:
        found = []
        for name, part in self.cell.parts.items():
            usage = part.usage()
            if usage is None:
                continue
            life = self._lives.get(name)
            if life is None or life.pid != usage.pid:
                life = self._lives[name] = _Life(usage.pid)
            settled = life.settle(usage)
            if life.rounds <= _SETTLED:
                continue
            growth = usage.private_kb - settled.private_kb
            self.worst_growth_kb[name] = max(self.worst_growth_kb.get(name, 0), growth)
            if usage.files > settled.files + _FILES:
                found.append(f"{name}: {usage.files} descriptors, {settled.files} when it had settled")
            if usage.threads > settled.threads + _THREADS:
                found.append(f"{name}: {usage.threads} threads, {settled.threads} when it had settled")
            if growth > _GROWTH_KB:
                found.append(f"{name}: {growth} KiB more memory of its own than when it had settled")
        return found
