"""Contenders take turns, arrangement by arrangement and round by round.

So that a slow moment of the machine hits all alike, and what is compared are ratios within one
run. In each round another contender is first.
"""

from __future__ import annotations

import statistics
from collections.abc import Sequence
from types import TracebackType
from typing import Any

from rosplc.bench.arrangements import Arrangement
from rosplc.bench.contenders.base import Contender, Place
from rosplc.bench.context import Context
from rosplc.bench.missing import Missing
from rosplc.bench.optional import need
from rosplc.bench.pair import Pair, Turn
from rosplc.bench.stats import distribution
from rosplc.errors import SetupError

__all__ = ["CYCLES", "Plan", "plan_turn", "take_turns"]

CYCLES = (10, 50, 100, 200, 300, 400, 500, 1000)
"""The source's numbers of cycles."""

_CALIBRATION = 10
_SHORT_TURN_NS = 100e6  # who is fast runs the whole list as often as fits into this
_MOST_REPEATS = 40
_ENOUGH_MEMORY_KIB = 1 << 20


class Plan:
    """How much one contender does in a turn.

    Attributes:
        warmup: Cycles before.
        repeats: How often it runs the list.
        cycles: The list: those of :data:`CYCLES` that fit into the time.
    """

    def __init__(self, warmup: int, repeats: int, cycles: tuple[int, ...]) -> None:
        self.warmup = warmup
        self.repeats = repeats
        self.cycles = cycles


def plan_turn(cycle_ns: float, seconds: float, *, repeat: bool) -> Plan:
    """Return the plan for a contender whose cycle takes so long.

    Args:
        cycle_ns: What one cycle takes.
        seconds: How long the turn may take.
        repeat: Whether who is fast runs the whole list again and again.
    """
    cycles = [CYCLES[0]]
    for count in CYCLES[1:]:
        if (sum(cycles) + count) * cycle_ns > seconds * 1e9:
            break
        cycles.append(count)
    if not repeat:
        return Plan(3, 1, tuple(cycles))
    repeats = int(min(_SHORT_TURN_NS, seconds * 1e9) / (sum(cycles) * cycle_ns))
    return Plan(200 if cycle_ns < 50_000 else 20, max(1, min(_MOST_REPEATS, repeats)), tuple(cycles))


class _Stable:
    """The pairs that run: kept from turn to turn where the machine has the memory for it."""

    def __init__(self, context: Context) -> None:
        self._context = context
        self._pairs: dict[str, Pair] = {}

    def get(self, contender: Contender) -> Pair:
        """Return a contender's pair, started if it is not running."""
        if contender.name not in self._pairs:
            place = Place.under(self._context.scratch, contender.name, self._context.cache)
            self._pairs[contender.name] = contender.start(place)
        return self._pairs[contender.name]

    def rest(self, contender: Contender) -> None:
        """End a contender's pair if memory is short."""
        if _available_memory_kib() < _ENOUGH_MEMORY_KIB:
            self._pairs.pop(contender.name).close()

    def drop(self, contender: Contender) -> None:
        """End a contender's pair by force."""
        pair = self._pairs.pop(contender.name, None)
        if pair is not None:
            pair.kill()

    def __enter__(self) -> _Stable:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        for pair in self._pairs.values():
            if error is None:
                pair.close()
            else:
                pair.kill()
        self._pairs.clear()


def _available_memory_kib() -> int:
    with open("/proc/meminfo", encoding="ascii") as file:  # noqa: PTH123 - a file of the kernel
        for line in file:
            if line.startswith("MemAvailable:"):
                return int(line.split()[1])
    return 0


def take_turns(
    context: Context, contenders: Sequence[Contender], arrangements: Sequence[Arrangement]
) -> list[dict[str, Any]]:
    """Measure contenders in arrangements; return one entry per arrangement, as JSON holds it.

    What is missing on this machine is skipped, what fails or ends with wrong values is noted as
    failed; both in the context.
    """
    possible = [each for each in arrangements if _possible(context, each)]
    wanted = [each for each in contenders if context.wants(each.name)]
    steps = sum(
        1 + _rounds(context, arrangement)
        for arrangement in possible
        for contender in wanted
        if arrangement.name in contender.ways
    )
    with _Stable(context) as stable:
        run = _Run(context, stable, steps)
        return [run.arrangement(each, wanted) for each in possible]


def _possible(context: Context, arrangement: Arrangement) -> bool:
    # Cyclic programs hardly ever meet on a core; those that spin would wait for each other there.
    if arrangement.cores <= len(context.cores) or arrangement.period_ns:
        return True
    context.skip(arrangement.title, f"it needs {arrangement.cores} cores, this machine gives one")
    return False


def _rounds(context: Context, arrangement: Arrangement) -> int:
    return context.effort.slow_rounds if arrangement.slow else context.effort.rounds


class _Run:
    """The state of one :func:`take_turns`."""

    def __init__(self, context: Context, stable: _Stable, steps: int) -> None:
        self._context = context
        self._stable = stable
        self._steps = steps
        self._done = 0
        self._out: set[str] = set()

    def arrangement(self, arrangement: Arrangement, contenders: Sequence[Contender]) -> dict[str, Any]:
        """Measure one arrangement."""
        here = [each for each in contenders if arrangement.name in each.ways and self._can(each, arrangement)]
        plans = {each.name: self._calibrate(arrangement, each) for each in here}
        turns: dict[str, list[Turn]] = {each.name: [] for each in here}
        for number in range(_rounds(self._context, arrangement)):
            first = number % max(1, len(here))
            for contender in here[first:] + here[:first]:
                plan = plans[contender.name]
                turn = None if plan is None else self._turn(arrangement, contender, plan)
                if turn is not None:
                    turns[contender.name].append(turn)
        return {
            "name": arrangement.name,
            "title": arrangement.title,
            "waiting": arrangement.waiting,
            "period_ns": arrangement.period_ns,
            "contenders": [_entry(each, arrangement, turns[each.name]) for each in here if turns[each.name]],
        }

    def _can(self, contender: Contender, arrangement: Arrangement) -> bool:
        try:
            if arrangement.name in contender.needs:
                need(contender.needs[arrangement.name])
        except Missing as missing:
            what = f"{contender.title}, {arrangement.title}"
            self._context.skip(what, missing.reason, missing.remedy)
            return False
        return True

    def _calibrate(self, arrangement: Arrangement, contender: Contender) -> Plan | None:
        turn = self._turn(arrangement, contender, Plan(2, 1, (_CALIBRATION,)))
        if turn is None:
            return None
        # The lower quartile: some cycles may have waited for the other side to come up, or for a core.
        cycle_ns = float(sorted(turn.spent_ns)[len(turn.spent_ns) // 4])
        effort = self._context.effort
        seconds = effort.slow_turn_seconds if arrangement.slow else effort.turn_seconds
        return plan_turn(max(cycle_ns, 1.0), seconds, repeat=not arrangement.slow)

    def _turn(self, arrangement: Arrangement, contender: Contender, plan: Plan) -> Turn | None:
        context = self._context
        context.notify(self._done, self._steps, f"{arrangement.title}, {contender.title}")
        self._done += 1
        if contender.name in self._out:
            return None
        try:
            turn = self._stable.get(contender).turn(
                arrangement,
                contender.ways[arrangement.name],
                context.cores,
                warmup=plan.warmup,
                repeats=plan.repeats,
                cycles=plan.cycles,
            )
            self._stable.rest(contender)
        except Missing as missing:
            context.skip(contender.title, missing.reason, missing.remedy)
        except SetupError as error:
            context.fail(f"{contender.title}, {arrangement.title}", error.what)
        else:
            if turn.wrong:
                reason = f"{turn.wrong} of {turn.runs} runs ended with wrong values"
                context.fail(f"{contender.title}, {arrangement.title}", reason)
            return turn
        self._stable.drop(contender)
        self._out.add(contender.name)
        return None


def _entry(contender: Contender, arrangement: Arrangement, turns: Sequence[Turn]) -> dict[str, Any]:
    return {
        "name": contender.name,
        "title": contender.title,
        "about": contender.about,
        "waits": contender.ways[arrangement.name].words,
        "rounds": [_round(turn) for turn in turns],
        "all": distribution([value for turn in turns for value in turn.spent_ns]),
        "runs": sum(turn.runs for turn in turns),
        "wrong": sum(turn.wrong for turn in turns),
    }


def _round(turn: Turn) -> dict[str, Any]:
    by_count = zip(*turn.durations_ns, strict=True)
    per_cycle = [
        duration / count / 1000
        for durations in turn.durations_ns
        for count, duration in zip(turn.cycles, durations, strict=True)
    ]
    return {
        # A run's mean, and of the runs the median: a rate, and yet no interruption of one run decides it.
        "run_us": statistics.median(per_cycle),
        "durations_s": {
            str(count): statistics.median(values) / 1e9
            for count, values in zip(turn.cycles, by_count, strict=True)
        },
        **distribution(turn.spent_ns),
        "cpu_us": turn.cpu_ns / turn.all_cycles / 1000,
        "cpu_share": turn.cpu_ns / turn.wall_ns,
    }
