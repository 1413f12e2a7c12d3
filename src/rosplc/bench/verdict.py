"""The answer for this machine, as a person reads it in the terminal."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

from rosplc.bench.markdown import cell_text
from rosplc.bench.results import Goal, Report
from rosplc.bench.section import Section, render

__all__ = ["verdict"]


def verdict(report: Report, sections: Mapping[str, Section]) -> Iterator[str]:
    """Yield the lines: what holds on this machine, the goals, what failed and what was left out."""
    facts = report.machine
    load = facts["load_before"][0]
    yield f"On this machine ({facts['processor']}, {facts['cores']} cores, load {load:.1f}):"
    goals: list[Goal] = []
    for page in render(report, sections).values():
        goals += page.goals
        for line in page.summary:
            yield f"  {line}"
    if goals:
        yield ""
        met = sum(goal.met is True for goal in goals)
        known = sum(goal.met is not None for goal in goals)
        yield f"Goals: {met} of {known} met, {len(goals) - known} not measured"
        for goal in goals:
            yield f"  {_goal(goal)}"
    failures = [each for measured in report.sections for each in measured.failures]
    for failure in failures:
        yield f"FAILED: {failure.what}: {failure.reason}"
    for skip in [each for measured in report.sections for each in measured.skips]:
        yield f"skipped: {skip.what}: {skip.reason}" + (f"; {skip.remedy}" if skip.remedy else "")


def _goal(goal: Goal) -> str:
    aim = f"{'at least' if goal.at_least else 'at most'} {goal.limit:g} x"
    if goal.measured is None:
        return f"[not measured] {goal.what}: {aim}" + (f" ({goal.reason})" if goal.reason else "")
    word = "met   " if goal.met else "missed"
    found = f"[{word}] {goal.what}: {cell_text(goal.measured)} x, aimed at {aim}"
    return found + (f" ({goal.reason})" if goal.reason and not goal.met else "")
