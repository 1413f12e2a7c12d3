"""What both of the demonstration's PLC programs share: the task, and what is kept of messages."""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Callable, Iterable
from statistics import median, quantiles
from typing import Any, Protocol

from rosplc.demo.messages import Opened, Tally
from rosplc.demo.processes import Commands, report
from rosplc.virtual_plc import CycleStats, VirtualPlc

_STATUS_SECONDS = 0.1
_AGES_KEPT = 200_000


class Arrivals:
    """What came, per topic: counted in ``tallies``, and how old it was."""

    def __init__(self, topics: Iterable[str]) -> None:
        self.tallies = {topic: Tally() for topic in topics}
        self._ages: dict[str, deque[int]] = {topic: deque(maxlen=_AGES_KEPT) for topic in self.tallies}

    def add(self, topic: str, opened: Opened, now_ns: int) -> None:
        """Count a message that the program had in hand at ``now_ns`` (ns since 1970)."""
        self.tallies[topic].add(opened.number, whole=opened.whole)
        if opened.whole:
            self._ages[topic].append(now_ns - opened.stamp_ns)

    def summary(self) -> dict[str, dict[str, float]]:
        """Return median and p99 age in milliseconds, per topic and over all (``""``)."""
        ages = {topic: list(values) for topic, values in self._ages.items()}
        ages[""] = [age for values in list(ages.values()) for age in values]
        return {topic: _percentiles(values) for topic, values in ages.items() if values}

    def recent(self) -> dict[str, float]:
        """Return the age in milliseconds of each topic's last message."""
        return {topic: values[-1] / 1e6 for topic, values in self._ages.items() if values}


def _percentiles(values: list[int]) -> dict[str, float]:
    p99 = quantiles(values, n=100, method="inclusive")[98] if len(values) > 1 else values[0]
    return {"median_ms": median(values) / 1e6, "p99_ms": p99 / 1e6}


def serve(
    program: Callable[[], None],
    interval: float,
    commands: Commands,
    facts: Callable[[CycleStats], dict[str, Any]],
) -> CycleStats:
    """Run ``program`` every ``interval`` seconds and report until told to stop; return the statistics.

    Raises what the program raised.
    """
    plc = VirtualPlc()
    task = plc.task("RosTask", interval, priority=4)
    task.program(program)
    with plc:
        while not commands.stop.wait(_STATUS_SECONDS):
            plc.check()
            report("status", **facts(task.stats))
    return task.stats


class Program(Protocol):
    """A PLC program of the demonstration; ``state`` is what it last knew, guarded by ``lock``."""

    arrivals: Arrivals
    lock: threading.Lock
    state: dict[str, Any]

    def __call__(self) -> None:
        """Run one scan."""


def serve_demo(program: Program, interval: float, commands: Commands) -> None:
    """Run a program of the demonstration; its last report has the ages of all messages."""

    def facts(stats: CycleStats) -> dict[str, Any]:
        with program.lock:
            state = program.state
        age, drained = program.arrivals.recent(), commands.drain.is_set()
        return {"drained": drained, "cycle": stats.to_dict(), "age": age, **state}

    stats = serve(program, interval, commands, facts)
    report("status", cycle=stats.to_dict(), ages=program.arrivals.summary(), **program.state)
