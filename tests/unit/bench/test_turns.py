"""Contenders take turns: interleaved, planned by what they take, and failing one by one."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from rosplc.errors import SetupError
from rosplc_bench.experiment import durations, render
from rosplc_bench.pairs import (
    CYCLES,
    CYCLIC,
    ONE_CORE,
    TWO_CORES,
    Contender,
    Place,
    Plan,
    Turn,
    Way,
    plan_turn,
    take_turns,
)
from rosplc_bench.report import distribution, median_ratio
from rosplc_bench.run import Context, Effort, Missing

EFFORT = Effort("test", 3, 1.0, 2, 0.1)


class FakePair:
    """A pair without processes: each cycle takes the same time."""

    def __init__(self, name: str, cycle_ns: int, log: list[str], wrong: int = 0, error: str = "") -> None:
        self.name, self.cycle_ns, self.log, self.wrong, self.error = name, cycle_ns, log, wrong, error

    def turn(self, arrangement: Any, way: Way, cores: Any, plan: Plan) -> Turn:
        if self.error:
            raise SetupError("SYS002", self.error)
        self.log.append(self.name)
        durations_ns = [[count * self.cycle_ns for count in plan.cycles] for _ in range(plan.repeats)]
        spent = [self.cycle_ns] * (sum(plan.cycles) * plan.repeats)
        return Turn(plan, durations_ns, spent, self.wrong, plan.repeats * len(plan.cycles), 1e3, 1e3)

    def close(self) -> None:
        self.log.append(f"{self.name} closed")

    kill = close

    def __exit__(self, *_error: object) -> None:
        self.close()


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
        (f"A, {ONE_CORE.title}", "pip install rosplc-bench")
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


def test_ratios_are_computed_from_the_data() -> None:
    """Other data give other ratios; what is absent has no row."""
    each = {"about": "a fake", "waits": "spins", "wrong": 0, "runs": 1}
    every = {"count": 1, "p50_us": 1.0, "p99_us": 1.0, "p999_us": 1.0, "max_us": 1.0}
    for own, expected in ((0.5, 300.0), (1.0, 150.0)):
        figures = {"rosplc-c": own, "bare": 0.4, "libmodbus": 150.0}
        entries = [
            {
                **each,
                "name": name,
                "title": name.upper(),
                "all": every,
                "rounds": [
                    {"run_us": value, "p99_us": value * 2, "cpu_us": 1.0, "durations_s": {"10": value}}
                ],
            }
            for name, value in figures.items()
        ]
        data = [{"name": TWO_CORES.name, "title": "Two", "waiting": "spin", "contenders": entries}]
        ratios = render({"arrangements": data, "cycles": [10]}).tables[0]
        assert [row[1] for row in ratios.rows] == ["BARE (spins)", "LIBMODBUS (spins)"]
        assert ratios.rows[1][2:5] == (150.0, own, pytest.approx(expected))


def test_arrangements_say_how_one_waits() -> None:
    """No arrangement is without a sentence about waiting."""
    assert all(each.waiting for each in (TWO_CORES, ONE_CORE, *CYCLIC))
