"""Contenders take turns: interleaved, planned by what they take, and failing one by one."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from rosplc.bench.arrangements import CYCLIC, ONE_CORE, TWO_CORES, Way
from rosplc.bench.contenders.base import Contender, Place
from rosplc.bench.context import Context, Effort
from rosplc.bench.experiment_goals import goals
from rosplc.bench.found import Found, durations
from rosplc.bench.missing import Missing
from rosplc.bench.pair import Turn
from rosplc.bench.stats import distribution, median_ratio
from rosplc.bench.turns import CYCLES, plan_turn, take_turns
from rosplc.errors import SetupError

EFFORT = Effort("test", 3, 1.0, 2, 0.1)


class FakePair:
    """A pair without processes: each cycle takes the same time."""

    def __init__(self, name: str, cycle_ns: int, log: list[str], wrong: int = 0, error: str = "") -> None:
        self.name, self.cycle_ns, self.log, self.wrong, self.error = name, cycle_ns, log, wrong, error

    def turn(
        self, arrangement: Any, way: Way, cores: Any, *, warmup: int, repeats: int, cycles: tuple[int, ...]
    ) -> Turn:
        if self.error:
            raise SetupError("SYS002", self.error)
        self.log.append(self.name)
        durations_ns = [[count * self.cycle_ns for count in cycles] for _ in range(repeats)]
        spent = [self.cycle_ns] * (sum(cycles) * repeats)
        runs = repeats * len(cycles)
        return Turn(tuple(cycles), durations_ns, spent, self.wrong, runs, 1e3, 1e3, len(spent))

    def close(self) -> None:
        self.log.append(f"{self.name} closed")

    kill = close


def contender(name: str, pair: FakePair | Missing, arrangement: str = ONE_CORE.name) -> Contender:
    def start(place: Place) -> Any:
        if isinstance(pair, Missing):
            raise pair
        return pair

    return Contender(name, name.upper(), "a fake", {arrangement: Way("block", "sleeps")}, start)


def context(tmp_path: Path, **more: Any) -> Context:
    return Context(EFFORT, tmp_path, tmp_path, (0, 1), **more)


def test_turns_are_interleaved_and_another_is_first_each_time(tmp_path: Path) -> None:
    """After one calibration each, every round has all contenders, in an order that goes round."""
    log: list[str] = []
    who = [contender(name, FakePair(name, 1000, log)) for name in "abc"]
    (found,) = take_turns(context(tmp_path), who, [ONE_CORE])
    assert log[:12] == [*"abc", *"abc", *"bca", *"cab"]
    assert sorted(log[12:]) == ["a closed", "b closed", "c closed"]
    assert [len(each["rounds"]) for each in found["contenders"]] == [3, 3, 3]


def test_wrong_values_are_a_failure(tmp_path: Path) -> None:
    """A contender whose final values are wrong is reported as failed, with how many runs."""
    here = context(tmp_path)
    (found,) = take_turns(here, [contender("bad", FakePair("bad", 1000, [], wrong=1))], [ONE_CORE])
    assert here.failures and all("wrong values" in each.reason for each in here.failures)
    assert found["contenders"][0]["wrong"] == 3


def test_what_is_missing_is_skipped_and_what_fails_does_not_stop_the_others(tmp_path: Path) -> None:
    """A missing package is named once with its remedy; a process that ends is a failure; the rest goes on."""
    here = context(tmp_path)
    who = [
        contender("missing", Missing("no gcc", "install it")),
        contender("broken", FakePair("broken", 1000, [], error="it ended")),
        contender("good", FakePair("good", 1000, [])),
    ]
    (found,) = take_turns(here, who, [ONE_CORE])
    assert [(each.what, each.reason, each.remedy) for each in here.skips] == [
        ("MISSING", "no gcc", "install it")
    ]
    assert [each.reason for each in here.failures] == ["it ended"]
    assert [each["name"] for each in found["contenders"]] == ["good"]


def test_a_way_to_wait_that_needs_a_missing_package_is_left_out_alone(tmp_path: Path) -> None:
    """Where one arrangement lacks a package, that one is skipped with the remedy; the others are measured."""
    way, here = Way("block", "sleeps"), context(tmp_path)
    who = Contender(
        "a",
        "A",
        "a fake",
        {ONE_CORE.name: way, TWO_CORES.name: way},
        lambda _place: FakePair("a", 1000, []),  # type: ignore[arg-type, return-value]
        {ONE_CORE.name: "no_such_package"},
    )
    found = {each["name"]: each["contenders"] for each in take_turns(here, [who], [ONE_CORE, TWO_CORES])}
    assert not found[ONE_CORE.name] and len(found[TWO_CORES.name]) == 1
    assert [(each.what, each.remedy) for each in here.skips] == [
        (f"A, {ONE_CORE.title}", "pip install 'rosplc[bench]'")
    ]


def test_only_the_wanted_are_measured(tmp_path: Path) -> None:
    """With names given, nobody else is started."""
    log: list[str] = []
    who = [contender(name, FakePair(name, 1000, log)) for name in "ab"]
    (found,) = take_turns(context(tmp_path, only=("b",)), who, [ONE_CORE])
    assert "a" not in log and [each["name"] for each in found["contenders"]] == ["b"]


def test_one_core_leaves_two_cores_out(tmp_path: Path) -> None:
    """Where the machine gives one core, spinning on two is skipped with the reason."""
    here = Context(EFFORT, tmp_path, tmp_path, (0,))
    assert take_turns(here, [], [TWO_CORES]) == []
    assert "2 cores" in here.skips[0].reason


def test_progress_counts_every_turn(tmp_path: Path) -> None:
    """Each turn is announced, with the same total; nothing is announced twice."""
    told: list[tuple[int, int]] = []
    here = context(tmp_path, notify=lambda done, total, _: told.append((done, total)))
    take_turns(here, [contender("a", FakePair("a", 1000, []))], [ONE_CORE])
    assert told == [(number, 4) for number in range(4)]


def test_a_plan_fits_into_its_time() -> None:
    """Who is fast repeats the whole list, who is slow runs a part of it, at least the first number."""
    fast = plan_turn(500.0, 5.0, repeat=True)
    assert fast.cycles == CYCLES and fast.repeats == 40
    slow = plan_turn(1e6, 1.0, repeat=True)
    assert slow.cycles == (10, 50, 100, 200, 300) and slow.repeats == 1
    assert plan_turn(1e9, 1.0, repeat=True).cycles == (10,)
    assert plan_turn(500.0, 1.0, repeat=False).repeats == 1


def test_statistics_of_known_values() -> None:
    """Percentiles are values that were measured; a ratio is the median of the rounds' ratios."""
    found = distribution(list(range(1000, 1_001_000, 1000)))
    assert found == {"count": 1000, "p50_us": 500.0, "p99_us": 990.0, "p999_us": 999.0, "max_us": 1000.0}
    assert median_ratio([2.0, 9.0, 4.0], [1.0, 3.0, 1.0]) == 3.0


def test_durations_are_medians_of_rounds() -> None:
    """By number of cycles, the median over the rounds that have it."""
    rounds = [
        {"durations_s": {"10": value, **({"50": 7.0} if value > 2 else {})}} for value in (1.0, 2.0, 9.0)
    ]
    assert durations({"rounds": rounds}) == {10: 2.0, 50: 7.0}


def measured(**figures: float) -> Found:
    """Return data in which each contender takes so many microseconds, on two cores and on one."""
    entries = [
        {
            "name": name.replace("_", "-"),
            "title": name,
            "rounds": [{"run_us": value, "p99_us": value * 2, "cpu_us": 1.0}],
        }
        for name, value in figures.items()
    ]
    return Found([{"name": each.name, "title": "", "contenders": entries} for each in (TWO_CORES, ONE_CORE)])


def test_goals_are_computed_from_the_data() -> None:
    """Other data give other ratios and other verdicts; what is absent is not measured, never met."""
    quick = {goal.what: goal for goal in goals(measured(rosplc_c=0.5, bare=0.4, libmodbus=150.0))}
    slow = {goal.what: goal for goal in goals(measured(rosplc_c=1.0, bare=0.4, libmodbus=150.0))}
    modbus = next(what for what in quick if what.startswith("two cores, C: libmodbus"))
    bare = next(what for what in quick if "bare" in what)
    assert (quick[modbus].measured, quick[modbus].met) == (pytest.approx(300.0), True)
    assert (slow[modbus].measured, slow[modbus].met) == (pytest.approx(150.0), False)
    assert (quick[bare].measured, quick[bare].met) == (pytest.approx(1.25), True)
    assert (slow[bare].measured, slow[bare].met) == (pytest.approx(2.5), False)
    assert "1.00 µs" in slow[bare].reason and "0.400 µs" in slow[bare].reason
    absent = [goal for goal in quick.values() if goal.measured is None]
    assert len(absent) == len(quick) - 3 and all(goal.met is None and goal.reason for goal in absent)


def test_the_faster_of_two_others_counts() -> None:
    """A goal against either of iceoryx2's patterns is measured against the faster one."""
    found = measured(rosplc_python=2.0, iceoryx2=10.0, iceoryx2_blackboard=6.0)
    goal = next(goal for goal in goals(found) if "iceoryx2" in goal.what)
    assert goal.measured == pytest.approx(3.0)


def test_arrangements_say_how_one_waits() -> None:
    """No arrangement is without a sentence about waiting."""
    assert all(each.waiting for each in (TWO_CORES, ONE_CORE, *CYCLIC))
