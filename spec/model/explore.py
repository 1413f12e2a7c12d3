"""Exhaustive breadth-first search over the two machines of :mod:`protocol`.

States of memory and writer are numbered separately from states of the reader. A state of the whole system
is therefore one integer, the writer's steps are computed once per writer state, and a few million states
fit into memory. Because the search is breadth-first, it finds a shortest counterexample.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from itertools import pairwise
from typing import Generic, TypeVar

from protocol import Config, Reader, Writer
from reading import reader_steps
from writing import initial, writer_steps

__all__ = ["Result", "explore"]

SHIFT = 32


@dataclass(frozen=True)
class Result:
    """The result of a search.

    Attributes:
        states: Distinct states visited.
        steps: Transitions between them.
        accepted: Distinct accepting steps; 0 means that nothing was tested.
        violation: The broken property; empty if none.
        trace: The steps that lead to the violation.
    """

    states: int
    steps: int
    accepted: int
    violation: str
    trace: tuple[str, ...]


State = TypeVar("State")


class _Numbers(Generic[State]):
    """Numbers for states, in order of appearance."""

    def __init__(self) -> None:
        self.of: dict[State, int] = {}
        self.states: list[State] = []

    def __call__(self, state: State) -> int:
        number = self.of.setdefault(state, len(self.states))
        if number == len(self.states):
            self.states.append(state)
        return number


def explore(config: Config) -> Result:
    """Visit every reachable state, or stop at the first broken property."""
    writers: _Numbers[Writer] = _Numbers()
    readers: _Numbers[Reader] = _Numbers()
    first_writer, first_reader = initial(config)
    first = writers(first_writer) << SHIFT | readers(first_reader)
    parents: dict[int, int] = {first: -1}
    queue = deque([first])
    ahead: dict[int, list[int]] = {}
    disturbed: dict[int, int] = {}
    steps = accepted = 0
    mask = (1 << SHIFT) - 1
    while queue:
        state = queue.popleft()
        w, r = state >> SHIFT, state & mask
        if w not in ahead:
            ahead[w] = [writers(after) for _, after in writer_steps(config, writers.states[w])]
        if r not in disturbed:
            disturbed[r] = readers(_disturb(readers.states[r]))
        found = [after << SHIFT | disturbed[r] for after in ahead[w]]
        for label, after, violation in reader_steps(config, writers.states[w], readers.states[r]):
            if violation:
                trace = (*_trace(config, writers, readers, parents, state), f"reader  {label}")
                return Result(len(parents), steps, accepted, violation, trace)
            accepted += "ACCEPTS" in label
            found.append(w << SHIFT | readers(after))
        steps += len(found)
        for one in found:
            if one not in parents:
                parents[one] = state
                queue.append(one)
    return Result(len(parents), steps, accepted, "", ())


def _disturb(reader: Reader) -> Reader:
    return reader._replace(quiet=False) if max(reader.s, reader.h, reader.rule) >= 0 else reader


def _trace(
    config: Config, writers: _Numbers[Writer], readers: _Numbers[Reader], parents: dict[int, int], state: int
) -> list[str]:
    """Return the labels of the steps from the first state to this one."""
    path = [state]
    while parents[path[-1]] >= 0:
        path.append(parents[path[-1]])
    path.reverse()
    lines = []
    mask = (1 << SHIFT) - 1
    for before, after in pairwise(path):
        writer, reader = writers.states[before >> SHIFT], readers.states[before & mask]
        target = writers.states[after >> SHIFT], readers.states[after & mask]
        for label, one in writer_steps(config, writer):
            if (one, _disturb(reader)) == target:
                lines.append(f"memory  {label}")
                break
        else:
            for step in reader_steps(config, writer, reader):
                if (writer, step.after) == target:
                    lines.append(f"reader  {step.label}")
                    break
    return lines
