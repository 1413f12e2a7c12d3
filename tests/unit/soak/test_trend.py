"""The test for leaks: what grows is found, what only moves is not."""

from __future__ import annotations

import random
from typing import Any

import pytest

from tests.soak.results import LEAST_ROUNDS, leaks, trends


def life(rounds: int, **what: Any) -> list[dict[str, Any]]:
    """Give samples of one bridge; each quantity is a function of the round."""
    still = {"files": lambda _: 20, "threads": lambda _: 10, "private_kb": lambda _: 40_000}
    return [
        {"round": n, "bridge": {"pid": 7, **{name: of(n) for name, of in (still | what).items()}}}
        for n in range(rounds)
    ]


@pytest.mark.parametrize(
    "what",
    [
        {"files": lambda n: 20 + n // 27},
        {"threads": lambda n: 10 + n // 20},
        {"private_kb": lambda n: 40_000 + 30 * n},
    ],
    ids=["one descriptor per reload", "one thread now and then", "30 KiB per round"],
)
def test_what_grows_is_a_leak(what: dict[str, Any]) -> None:
    """A descriptor, a thread or some memory that is lost with each fault of a kind is found."""
    (found,) = leaks(life(300, **what))
    assert found.startswith(f"bridge: {next(iter(what))} rose from")


def test_what_moves_is_none() -> None:
    """Neither noise nor what a program takes while it settles is a leak."""
    dice = random.Random(1)
    samples = life(
        400,
        files=lambda _: 17 + dice.randrange(5),
        private_kb=lambda n: 40_000 + min(n, 80) * 100 + dice.randrange(300),
    )
    assert leaks(samples) == []


def test_only_one_life_that_is_long_enough_is_judged() -> None:
    """Processes that were killed soon say nothing, however different they are from each other."""
    samples = life(LEAST_ROUNDS - 1)
    for n, sample in enumerate(life(LEAST_ROUNDS - 1, private_kb=lambda n: 90_000 + 900 * n)):
        sample["bridge"]["pid"] = 8 + n % 3
        samples.append(sample)
    assert trends(samples) == []


def test_locks_of_topics_that_a_reload_adds_are_no_leak() -> None:
    """The bridge holds a descriptor for each object; that there are more objects is no rise."""
    samples = life(200, files=lambda n: 13 + 4 + n // 25)
    assert leaks(samples) != []
    for number, sample in enumerate(samples):
        sample["objects"] = 2 * (4 + number // 25)
    assert leaks(samples) == []
