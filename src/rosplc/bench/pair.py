"""A pair of processes that exchange messages, and what one turn of it gives."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from types import TracebackType

from rosplc.bench.arrangements import Arrangement, Way
from rosplc.bench.process import Side, pin

__all__ = ["Pair", "Turn"]

_START_SECONDS = 60.0
_TURN_SECONDS = 320.0  # a little longer than the processes' own watchdog


@dataclass(frozen=True)
class Turn:
    """What one turn gave.

    Attributes:
        cycles: The numbers of cycles that were run, in order.
        durations_ns: One list per repetition: how long each number of cycles took.
        spent_ns: Every cycle's time, there and back.
        wrong: Runs whose final values were not what they must be.
        runs: Runs in all.
        cpu_ns: Processor time of both processes, warm-up included.
        wall_ns: The time that it took, warm-up included.
        all_cycles: Cycles in all, warm-up included.
    """

    cycles: tuple[int, ...]
    durations_ns: list[list[int]]
    spent_ns: list[int]
    wrong: int
    runs: int
    cpu_ns: float
    wall_ns: float
    all_cycles: int


class Pair:
    """Two sides; a context manager that ends them.

    Args:
        a: Side A, which measures.
        b: Side B, which answers.
        release: Called once, when both have ended: removes what they shared.
    """

    def __init__(self, a: Side, b: Side, release: Callable[[], None]) -> None:
        self.a = a
        self.b = b
        self._releases = [release]

    def turn(
        self,
        arrangement: Arrangement,
        way: Way,
        cores: Sequence[int],
        *,
        warmup: int,
        repeats: int,
        cycles: Sequence[int],
    ) -> Turn:
        """Run the experiment once.

        Args:
            arrangement: Where the processes run.
            way: How they wait.
            cores: The cores that may be used.
            warmup: Cycles before, not counted; at least 2.
            repeats: How often the whole list of cycles is run.
            cycles: How many cycles each run has; each at least 2, or else nothing changes.

        Raises:
            SetupError: SYS002, a process failed, or hangs.
        """
        second = cores[min(1, len(cores) - 1)] if arrangement.cores > 1 else cores[0]
        pin([self.a.pid], cores[0])
        pin([self.b.pid], second)
        total = warmup + repeats * sum(cycles)
        words = f"{way.order} {arrangement.period_ns}"
        cpu = self._cpu()
        began = time.perf_counter_ns()
        self.b.order(f"answer {words} {total}")
        self.b.hear(_START_SECONDS)
        self.a.order(f"run {words} {warmup} {repeats} {' '.join(map(str, cycles))}")
        facts = self.a.hear_json(_TURN_SECONDS)
        wall_ns, cpu_ns = time.perf_counter_ns() - began, (self._cpu() - cpu) * 1e9
        spent = self.a.hear_json(_START_SECONDS)
        return Turn(
            tuple(cycles), facts["durations_ns"], spent, facts["wrong"], facts["runs"], cpu_ns, wall_ns, total
        )

    def _cpu(self) -> float:
        return self.a.cpu_seconds() + self.b.cpu_seconds()

    def close(self) -> None:
        """End both in order, and remove what they shared; a second call does nothing."""
        self.a.close()
        self.b.close()
        while self._releases:
            self._releases.pop()()

    def kill(self) -> None:
        """End both by force: one of them may be waiting for a message that never comes."""
        self.a.kill()
        self.b.kill()
        self.close()

    def on_release(self, release: Callable[[], None]) -> None:
        """Have something else called when both have ended."""
        self._releases.append(release)

    def __enter__(self) -> Pair:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if error is None:
            self.close()
        else:
            self.kill()
