"""Pairs of processes that exchange messages: where they run, how they wait, and how contenders take turns.

The way to wait decides a figure more than what carries the data, so each is measured apart and named with
every table. Contenders take turns, arrangement by arrangement and round by round, so that a slow moment of
the machine affects all alike, and what is compared are ratios within one run. In each round another one is
first.
"""

from __future__ import annotations

import contextlib
import statistics
import sys
import tempfile
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from types import TracebackType
from typing import Any, NamedTuple

from rosplc.errors import SetupError
from rosplc_bench.process import Side, pin
from rosplc_bench.report import distribution
from rosplc_bench.run import Context, Missing, need


@dataclass(frozen=True)
class Arrangement:
    """Where the processes run.

    Attributes:
        name: In the report's JSON.
        title: In headings.
        cores: How many cores the two processes use.
        period_ns: The period of both programs; 0 if they are not cyclic.
        waiting: How each side waits in it, for the line below every table.
        slow: Whether a turn is mostly waiting, with every contender: fewer and shorter turns do.
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
    "each process has a core of its own and polls without a pause (spins) where the contender allows it; "
    "the column names those that block instead",
)
ONE_CORE = Arrangement(
    "one-core",
    "One core, blocking",
    1,
    0,
    "both processes share one core, as on a BeagleBone, and sleep until they are woken",
)
_SHARED = "both processes share one core; the column shows what the waiting side does"
ONE_CORE_BUSY = Arrangement("one-core-busy", "One core, polling without a pause", 1, 0, _SHARED, True)
ONE_CORE_YIELD = Arrangement("one-core-yield", "One core, yielding between two polls", 1, 0, _SHARED)
ONE_CORE_CYCLE = Arrangement(
    "one-core-cycle", "One core, polling every millisecond", 1, 1_000_000, _SHARED, True
)
TWO_CORES_BLOCKING = Arrangement(
    "two-cores-blocking",
    "Two cores, blocking",
    2,
    0,
    "each process has a core of its own and sleeps until it is woken",
)
_CYCLE = (
    "both programs are cyclic and poll once per period, B half a period after A; each has a core of its own "
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
        self.b.send(f"answer {words} {total}")
        self.b.receive()
        self.a.send(f"run {words} {warmup} {repeats} {' '.join(map(str, cycles))}")
        facts = self.a.receive_json(_TURN_SECONDS)
        wall_ns, cpu_ns = time.perf_counter_ns() - began, (self._cpu() - cpu) * 1e9
        spent = self.a.receive_json()
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


SPINS = Way("spin", "spins")
BLOCKS = Way("block", "blocks in the socket")
RINGS = Way("block", "sleeps on a named semaphore beside it")
CYCLE = Way("cycle", "polls once per period")


@dataclass(frozen=True)
class Place:
    """Where one pair puts what it shares.

    Attributes:
        folder: A folder in /dev/shm of this pair's own.
        names: Names for POSIX semaphores, which know no folders: A's, B's.
        cache: Where compiled programs are kept.
    """

    folder: Path
    names: tuple[str, str]
    cache: Path

    @classmethod
    def under(cls, scratch: Path, label: str, cache: Path) -> Place:
        """Make a place in a run's folder, whose own name is unique on this machine."""
        folder = Path(tempfile.mkdtemp(prefix=f"{label}-", dir=scratch))
        name = f"/{scratch.name}.{folder.name}"
        return cls(folder, (f"{name}.a", f"{name}.b"), cache)

    def remove_semaphores(self) -> None:
        """Take the semaphores' names away; who has them open keeps them."""
        for name in self.names:
            with contextlib.suppress(FileNotFoundError):
                Path(f"/dev/shm/sem.{name[1:]}").unlink()


@dataclass(frozen=True)
class Contender:
    """One way to exchange data.

    Attributes:
        name: What ``--only`` calls it.
        title: What tables call it.
        about: What exactly was measured, one sentence.
        ways: How it waits, by arrangement; what is missing cannot be done with it.
        start: Starts both processes. Raises Missing if the machine lacks something, SetupError if it fails.
        needs: Arrangement → the Python package that waiting in it takes, beyond what ``start`` takes.
    """

    name: str
    title: str
    about: str
    ways: Mapping[str, Way]
    start: Callable[[Place], Pair]
    needs: Mapping[str, str] = field(default_factory=dict)


def ready(side: Side) -> str:
    """Wait until a side has started; return what it prints beyond that.

    Raises:
        SetupError: SYS002, it did not start.
    """
    word, _, rest = side.receive().partition(" ")
    if word != "ready":
        raise SetupError("SYS002", f"{word} {rest}".strip())
    return rest


def start_pair(
    name: str,
    place: Place,
    *,
    a: Sequence[str],
    b: Sequence[str],
    order: str = "AB",
    pass_on: bool = False,
) -> Pair:
    """Start two programs one after the other and wait for both.

    Args:
        name: What errors call them.
        place: Where they share.
        a: A's command.
        b: B's command.
        order: "AB" or "BA": who is first.
        pass_on: Whether the second gets as a further argument what the first said.
    """
    sides: dict[str, Side] = {}
    commands = {"A": list(a), "B": list(b)}
    extra: list[str] = []
    try:
        for letter in order:
            sides[letter] = Side(f"{name}, side {letter}", commands[letter] + extra)
            said = ready(sides[letter])
            extra = [said] if pass_on else []
    except BaseException:
        for side in sides.values():
            side.kill()
            side.close()
        place.remove_semaphores()
        raise
    # Both have them open: without names nothing can be left behind, whatever happens from here on.
    place.remove_semaphores()
    return Pair(sides["A"], sides["B"], place.remove_semaphores)


def python_side(module: str, side: str, *arguments: object) -> list[str]:
    """Return the command of a peer in Python."""
    return [sys.executable, "-m", "rosplc_bench.peers", module, side, *map(str, arguments)]


CYCLES = (10, 50, 100, 200, 300, 400, 500, 1000)
"""The numbers of cycles in one run."""

_CALIBRATION = 10
_SHORT_TURN_NS = 100e6  # a fast contender runs the whole list as often as fits into this
_MOST_REPEATS = 40
_ENOUGH_MEMORY_KIB = 1 << 20


class Plan(NamedTuple):
    """How much one contender does in a turn.

    Attributes:
        warmup: Cycles before.
        repeats: How often it runs the list.
        cycles: The list: those of :data:`CYCLES` that fit into the time.
    """

    warmup: int
    repeats: int
    cycles: tuple[int, ...]


def plan_turn(cycle_ns: float, seconds: float, *, repeat: bool) -> Plan:
    """Return the plan for a contender whose cycle takes so long.

    Args:
        cycle_ns: What one cycle takes.
        seconds: How long the turn may take.
        repeat: Whether a fast contender runs the whole list again and again.
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


class _Pairs:
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

    def release(self, contender: Contender) -> None:
        """End a contender's pair if memory is short."""
        if _available_memory_kib() < _ENOUGH_MEMORY_KIB:
            self._pairs.pop(contender.name).close()

    def drop(self, contender: Contender) -> None:
        """End a contender's pair by force."""
        pair = self._pairs.pop(contender.name, None)
        if pair is not None:
            pair.kill()

    def __enter__(self) -> _Pairs:
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
    with open("/proc/meminfo", encoding="ascii") as file:
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
    with _Pairs(context) as pairs:
        run = _Run(context, pairs, steps)
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

    def __init__(self, context: Context, pairs: _Pairs, steps: int) -> None:
        self._context = context
        self._pairs = pairs
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
            turn = self._pairs.get(contender).turn(
                arrangement,
                contender.ways[arrangement.name],
                context.cores,
                warmup=plan.warmup,
                repeats=plan.repeats,
                cycles=plan.cycles,
            )
            self._pairs.release(contender)
        except Missing as missing:
            context.skip(contender.title, missing.reason, missing.remedy)
        except SetupError as error:
            context.fail(f"{contender.title}, {arrangement.title}", error.what)
        else:
            if turn.wrong:
                reason = f"{turn.wrong} of {turn.runs} runs ended with wrong values"
                context.fail(f"{contender.title}, {arrangement.title}", reason)
            return turn
        self._pairs.drop(contender)
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
