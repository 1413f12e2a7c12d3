"""The judge of a round: what is lost must be counted, as far as those live who count."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import pytest

from tests.soak.checks import Checker
from tests.soak.faults import Fault
from tests.soak.messages import TOPICS
from tests.soak.processes import Usage

pytestmark = pytest.mark.verifies("campaign", own="simulated violations, which the checks must detect")


class Part:
    """A process of the cell."""

    alive = True

    def __init__(self, pid: int) -> None:
        self.held = Usage(pid, 20, 10, 60_000, 40_000)

    @property
    def pid(self) -> int:
        return self.held.pid

    def usage(self) -> Usage:
        return self.held


class Cell:
    """A cell whose counters a test sets: missing and counted per topic."""

    private = False

    def __init__(self, backend: str = "dds") -> None:
        names = ("bridge", "plc", "publisher", "subscriber", *(("hub",) if backend != "dds" else ()))
        self.backend = backend
        self.parts = {name: Part(number) for number, name in enumerate(names, 100)}
        self.figures = [(0, 0)] * len(TOPICS)
        self.counters: Any = self

    def losses(self) -> list[tuple[int, int]]:
        return self.figures

    def violations(self) -> dict[str, int]:
        return {}

    def marks(self) -> list[tuple[int, int]]:
        return []

    def await_flow(self, _marks: object) -> float:
        return 0.0

    def await_diagnostics(self) -> None: ...

    def wait(self, _condition: object, _what: str) -> None: ...


ANYTHING = Fault("anything", lambda _cell, _dice: None)
"""A fault after which every topic is accounted for."""


def judged(cell: Cell, figures: tuple[int, int], *replaced: str) -> list[str]:
    """Return what a round finds in which all topics come to these figures and some processes are replaced."""
    checker = Checker(cell)  # type: ignore[arg-type]
    checker.begin()
    cell.figures = [figures] * len(TOPICS)
    for name in replaced:
        cell.parts[name] = Part(cell.parts[name].pid + 1000)
    return checker.end(ANYTHING)


def test_what_is_counted_is_no_violation() -> None:
    """As many counted as missing, or more, is as it should be."""
    assert judged(Cell(), (7, 7)) == judged(Cell(), (7, 9)) == []


@pytest.mark.parametrize(
    ("replaced", "left"),
    [
        ((), TOPICS),
        (("publisher",), TOPICS),
        (("plc",), TOPICS[2:]),
        (("subscriber",), TOPICS[:2]),
        (("bridge",), ()),
        (("plc", "subscriber"), ()),
    ],
)
def test_what_is_not_counted_is_one(replaced: tuple[str, ...], left: tuple[str, ...]) -> None:
    """One message more than counted is found, on every topic on whose way nobody died who counts."""
    found = judged(Cell(), (7, 6), *replaced)
    assert found == [f"{topic}: 7 messages are missing, and 6 were counted" for topic in left]


@pytest.mark.parametrize(("backend", "count"), [("zenoh", 0), ("rospy", len(TOPICS))])
def test_a_router_has_messages_under_way_and_a_master_has_none(backend: str, count: int) -> None:
    """After a router's death nothing is accounted for, after a master's everything."""
    assert len(judged(Cell(backend), (7, 6), "hub")) == count


@pytest.mark.parametrize(("quantity", "more"), [("files", 20), ("threads", 12), ("private_kb", 40_000)])
def test_a_process_that_holds_much_more_than_when_it_had_settled(quantity: str, more: int) -> None:
    """What a process takes while it starts is nothing; the same later is found."""
    cell = Cell()
    checker = Checker(cell)  # type: ignore[arg-type]
    part = cell.parts["bridge"]
    full = replace(part.held, **{quantity: getattr(part.held, quantity) + more})
    for held in (part.held, full, full, full, full, full):
        part.held = held
        checker.begin()
        assert checker.end(ANYTHING) == []
    part.held = replace(full, **{quantity: getattr(full, quantity) + more})
    checker.begin()
    (found,) = checker.end(ANYTHING)
    assert found.startswith("bridge: ")
