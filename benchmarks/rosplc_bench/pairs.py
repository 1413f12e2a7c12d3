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
from typing import Any, NamedTuple

from rosplc.errors import SetupError
from rosplc_bench.process import Side, pin
from rosplc_bench.report import distribution
from rosplc_bench.run import Context, Missing, need


class Arrangement(NamedTuple):
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


class Way(NamedTuple):
    """How one contender waits in an arrangement.

    Attributes:
        order: What its processes are told: spin, yield, block or cycle.
        words: The same for people.
    """

    order: str
    words: str


_SPIN = (
    "each process has its own core and, if the contender allows it, polls without a pause (spins); the "
    "second column shows which contenders block instead"
)
_BLOCK = "both processes share one core, as on a BeagleBone, and sleep until they are woken"
_APART = "each process has its own core and sleeps until it is woken"
_SHARED = "both processes share one core; the second column shows what the waiting side does"
_CYCLE = (
    "both programs are cyclic and poll once per period; B polls half a period after A; each program has "
    "its own core if the machine has two"
)
_MS = 1_000_000
TWO_CORES = Arrangement("two-cores", "Two cores, spinning", 2, 0, _SPIN)
ONE_CORE = Arrangement("one-core", "One core, blocking", 1, 0, _BLOCK)
ONE_CORE_BUSY = Arrangement("one-core-busy", "One core, polling without a pause", 1, 0, _SHARED, True)
ONE_CORE_YIELD = Arrangement("one-core-yield", "One core, yielding between two polls", 1, 0, _SHARED)
ONE_CORE_CYCLE = Arrangement("one-core-cycle", "One core, polling every millisecond", 1, _MS, _SHARED, True)
TWO_CORES_BLOCKING = Arrangement("two-cores-blocking", "Two cores, blocking", 2, 0, _APART)
CYCLIC = (
    Arrangement("cycle-1ms", "Polling in a cycle of 1 ms", 2, _MS, _CYCLE, True),
    Arrangement("cycle-10ms", "Polling in a cycle of 10 ms", 2, 10 * _MS, _CYCLE, True),
)
ARRANGEMENTS = (TWO_CORES, ONE_CORE, *CYCLIC)
"""Those of the experiment, in the order of the report."""
WAITING = (ONE_CORE_BUSY, ONE_CORE_YIELD, ONE_CORE_CYCLE, ONE_CORE, TWO_CORES_BLOCKING)
"""Those that show what waiting alone does."""

SPINS = Way("spin", "spins")
BLOCKS = Way("block", "blocks on the socket")
RINGS = Way("block", "sleeps on an additional named semaphore")
CYCLE = Way("cycle", "polls once per period")

_TURN_SECONDS = 320.0  # a little longer than the processes' own watchdog


class Plan(NamedTuple):
    """How much one contender does in a turn.

    Attributes:
        warmup: Cycles before, not counted; at least 2.
        repeats: How often it runs the list.
        cycles: How many cycles each run has; each at least 2, or else nothing changes.
    """

    warmup: int
    repeats: int
    cycles: tuple[int, ...]

    @property
    def total(self) -> int:
        """Cycles in all, warm-up included."""
        return self.warmup + self.repeats * sum(self.cycles)


class Turn(NamedTuple):
    """What one turn gave.

    Attributes:
        plan: What was run.
        durations_ns: One list per repetition: how long each number of cycles took.
        spent_ns: Every cycle's time, there and back.
        wrong: Runs whose final values were not what they must be.
        runs: Runs in all.
        cpu_ns: Processor time of both processes, warm-up included.
        wall_ns: The time that it took, warm-up included.
    """

    plan: Plan
    durations_ns: list[list[int]]
    spent_ns: list[int]
    wrong: int
    runs: int
    cpu_ns: float
    wall_ns: float

    def to_dict(self) -> dict[str, Any]:
        """Return the figures of a round, as JSON holds them."""
        counts = self.plan.cycles
        per_cycle = [
            duration / count / 1000
            for durations in self.durations_ns
            for count, duration in zip(counts, durations, strict=True)
        ]
        columns = zip(counts, zip(*self.durations_ns, strict=True), strict=True)
        return {
            # A run's mean, and of the runs the median: a rate, and yet no interruption of one run decides it.
            "run_us": statistics.median(per_cycle),
            "durations_s": {str(count): statistics.median(values) / 1e9 for count, values in columns},
            **distribution(self.spent_ns),
            "cpu_us": self.cpu_ns / self.plan.total / 1000,
            "cpu_share": self.cpu_ns / self.wall_ns,
        }


class Pair:
    """Two sides; a context manager that ends them.

    Args:
        a: Side A, which measures.
        b: Side B, which answers.
        release: Called when both have ended: removes what they shared.
    """

    def __init__(self, a: Side, b: Side, release: Callable[[], None]) -> None:
        self.a = a
        self.b = b
        self._release = release

    def turn(self, arrangement: Arrangement, way: Way, cores: Sequence[int], plan: Plan) -> Turn:
        """Run the experiment once.

        Raises:
            SetupError: SYS002, a process failed, or hangs.
        """
        pin([self.a.pid], cores[0])
        pin([self.b.pid], cores[min(arrangement.cores, len(cores)) - 1])
        words = f"{way.order} {arrangement.period_ns}"
        cpu, began = self._cpu(), time.perf_counter_ns()
        self.b.send(f"answer {words} {plan.total}")
        self.b.receive()
        self.a.send(f"run {words} {plan.warmup} {plan.repeats} {' '.join(map(str, plan.cycles))}")
        facts = self.a.receive_json(_TURN_SECONDS)
        wall_ns, cpu_ns = time.perf_counter_ns() - began, (self._cpu() - cpu) * 1e9
        spent = self.a.receive_json()
        return Turn(plan, facts["durations_ns"], spent, facts["wrong"], facts["runs"], cpu_ns, wall_ns)

    def _cpu(self) -> float:
        return self.a.cpu_seconds() + self.b.cpu_seconds()

    def close(self) -> None:
        """End both in order, and remove what they shared; a second call does nothing."""
        self.a.close()
        self.b.close()
        self._release()

    def kill(self) -> None:
        """End both by force: one of them may be waiting for a message that never comes."""
        self.a.kill()
        self.b.kill()
        self.close()

    def __enter__(self) -> Pair:
        return self

    def __exit__(self, _kind: object, error: BaseException | None, _trace: object) -> None:
        if error is None:
            self.close()
        else:
            self.kill()


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
        """Take the semaphores' names away; a process that has them open keeps them."""
        for name in self.names:
            Path(f"/dev/shm/sem.{name[1:]}").unlink(missing_ok=True)


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


def start_pair(
    name: str,
    place: Place,
    a: Sequence[str],
    b: Sequence[str],
    *,
    server: bool = False,
    release: Callable[[], None] = lambda: None,
) -> Pair:
    """Start two programs one after the other and wait for both.

    Args:
        name: What errors call them.
        place: Where they share.
        a: A's command.
        b: B's command.
        server: Whether B starts first, and A gets as a further argument what B prints: its place.
        release: Called when both have ended, and if one does not start; calling it again must do no harm.

    Raises:
        SetupError: SYS002, one of them did not start.
    """
    with contextlib.ExitStack() as failed:
        # Both have them open by the end: without names nothing can be left behind, whatever happens then.
        failed.callback(place.remove_semaphores)
        failed.callback(release)

        def start(letter: str, command: Sequence[str]) -> tuple[Side, str]:
            side = failed.enter_context(Side(f"{name}, side {letter}", command))
            failed.callback(side.kill)
            word, _, rest = side.receive().partition(" ")
            if word != "ready":
                raise SetupError("SYS002", f"{word} {rest}".strip())
            return side, rest

        if server:
            second, place_of_b = start("B", b)
            first, _ = start("A", [*a, place_of_b])
        else:
            (first, _), (second, _) = start("A", a), start("B", b)
        failed.pop_all()
    place.remove_semaphores()
    return Pair(first, second, release)


def python_side(module: str, side: str, *arguments: object) -> list[str]:
    """Return the command of a peer in Python."""
    return [sys.executable, "-m", "rosplc_bench.peers", module, side, *map(str, arguments)]


CYCLES = (10, 50, 100, 200, 300, 400, 500, 1000)
"""The numbers of cycles in one run."""

_SHORT_TURN_NS = 100e6  # a fast contender runs the whole list as often as fits into this
_MOST_REPEATS = 40
_ENOUGH_MEMORY_KIB = 1 << 20


def plan_turn(cycle_ns: float, seconds: float, *, repeat: bool) -> Plan:
    """Return the plan for a contender whose cycle takes so long: those of :data:`CYCLES` that fit.

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


def _memory_is_short() -> bool:
    lines = Path("/proc/meminfo").read_text(encoding="ascii").splitlines()
    available = (int(line.split()[1]) for line in lines if line.startswith("MemAvailable:"))
    return next(available, 0) < _ENOUGH_MEMORY_KIB


def take_turns(
    context: Context, contenders: Sequence[Contender], arrangements: Sequence[Arrangement]
) -> list[dict[str, Any]]:
    """Measure contenders in arrangements; return one entry per arrangement, as JSON holds it.

    What is missing on this machine is skipped, what fails or ends with wrong values is noted as
    failed; both in the context.
    """
    with _Turns(context) as turns:
        possible = [each for each in arrangements if turns.possible(each)]
        wanted = [each for each in contenders if context.wants(each.name)]
        turns.steps = sum(
            1 + turns.rounds(here) for here in possible for each in wanted if here.name in each.ways
        )
        return [turns.arrangement(each, wanted) for each in possible]


class _Turns:
    """The state of one :func:`take_turns`: pairs keep running where the machine has the memory for it."""

    def __init__(self, context: Context) -> None:
        self._context = context
        self._pairs: dict[str, Pair] = {}
        self._out: set[str] = set()
        self._done = self.steps = 0

    def __enter__(self) -> _Turns:
        return self

    def __exit__(self, *error: Any) -> None:
        for pair in self._pairs.values():
            pair.__exit__(*error)

    def rounds(self, arrangement: Arrangement) -> int:
        """Return how many rounds an arrangement has."""
        effort = self._context.effort
        return effort.slow_rounds if arrangement.slow else effort.rounds

    def possible(self, arrangement: Arrangement) -> bool:
        """Return whether the machine has the cores; note if not."""
        # Cyclic programs hardly ever meet on a core; those that spin would wait for each other there.
        if arrangement.cores <= len(self._context.cores) or arrangement.period_ns:
            return True
        reason = f"it needs {arrangement.cores} cores, but this machine provides one"
        self._context.skip(arrangement.title, reason)
        return False

    def arrangement(self, arrangement: Arrangement, contenders: Sequence[Contender]) -> dict[str, Any]:
        """Measure one arrangement."""
        here = [each for each in contenders if arrangement.name in each.ways and self._can(each, arrangement)]
        plans = [self._calibrate(arrangement, each) for each in here]
        turns: dict[str, list[Turn]] = {each.name: [] for each in here}
        order = list(zip(here, plans, strict=True))
        for number in range(self.rounds(arrangement)):
            first = number % max(1, len(here))
            for contender, plan in order[first:] + order[:first]:
                if plan is not None and (turn := self._turn(arrangement, contender, plan)) is not None:
                    turns[contender.name].append(turn)
        return {
            "name": arrangement.name,
            "title": arrangement.title,
            "waiting": arrangement.waiting,
            "period_ns": arrangement.period_ns,
            "contenders": [_entry(each, arrangement, turns[each.name]) for each in here if turns[each.name]],
        }

    def _can(self, contender: Contender, arrangement: Arrangement) -> bool:
        with self._context.leaving_out(f"{contender.title}, {arrangement.title}"):
            if arrangement.name in contender.needs:
                need(contender.needs[arrangement.name])
            return True
        return False

    def _calibrate(self, arrangement: Arrangement, contender: Contender) -> Plan | None:
        turn = self._turn(arrangement, contender, Plan(2, 1, (10,)))
        if turn is None:
            return None
        # The lower quartile: some cycles may have waited for the other side to come up, or for a core.
        cycle_ns = float(sorted(turn.spent_ns)[len(turn.spent_ns) // 4])
        effort = self._context.effort
        seconds = effort.slow_turn_seconds if arrangement.slow else effort.turn_seconds
        return plan_turn(max(cycle_ns, 1.0), seconds, repeat=not arrangement.slow)

    def _turn(self, arrangement: Arrangement, contender: Contender, plan: Plan) -> Turn | None:
        context, name = self._context, contender.name
        context.notify(self._done, self.steps, f"{arrangement.title}, {contender.title}")
        self._done += 1
        if name in self._out:
            return None
        what = f"{contender.title}, {arrangement.title}"
        try:
            if name not in self._pairs:
                self._pairs[name] = contender.start(Place.under(context.scratch, name, context.cache))
            turn = self._pairs[name].turn(arrangement, contender.ways[arrangement.name], context.cores, plan)
            if _memory_is_short():
                self._pairs.pop(name).close()
        except Missing as missing:
            context.skip(contender.title, missing.reason, missing.remedy)
        except SetupError as error:
            context.fail(what, error.what)
        else:
            if turn.wrong:
                context.fail(what, f"{turn.wrong} of {turn.runs} runs ended with wrong values")
            return turn
        self._out.add(name)
        if name in self._pairs:
            self._pairs.pop(name).kill()
        return None


def _entry(contender: Contender, arrangement: Arrangement, turns: Sequence[Turn]) -> dict[str, Any]:
    return {
        "name": contender.name,
        "title": contender.title,
        "about": contender.about,
        "waits": contender.ways[arrangement.name].words,
        "rounds": [turn.to_dict() for turn in turns],
        "all": distribution(value for turn in turns for value in turn.spent_ns),
        "runs": sum(turn.runs for turn in turns),
        "wrong": sum(turn.wrong for turn in turns),
    }
