"""The answer for this machine, as a person reads it in the terminal."""

from __future__ import annotations

import textwrap
from collections.abc import Iterator, Mapping

from rosplc.bench.machine import busy, cores_text
from rosplc.bench.markdown import cell_text
from rosplc.bench.results import Goal, Report
from rosplc.bench.section import Section, render

__all__ = ["verdict"]


def verdict(report: Report, sections: Mapping[str, Section], width: int = 80) -> Iterator[str]:
    """Yield the lines: what holds on this machine, the goals, what failed and what was left out.

    Args:
        report: What was measured.
        sections: Every section by name.
        width: The terminal's, in characters.
    """
    facts = report.machine
    load = facts["load_before"][0]
    yield from _wrapped(
        f"On this machine ({facts['processor']}, {cores_text(facts)}, load {load:.1f}):", width
    )
    if remark := busy(facts):
        yield from _wrapped(remark, width, "  ")
    goals: list[Goal] = []
    for name, page in render(report, sections).items():
        goals += page.goals
        if page.summary:
            yield ""
            yield sections[name].title
        for line in page.summary:
            # A table's row keeps its columns; a sentence is broken where the terminal ends.
            yield from ([line] if line.startswith(" ") or not line else _wrapped(line, width, "  "))
    if goals:
        yield ""
        met = sum(goal.met is True for goal in goals)
        known = sum(goal.met is not None for goal in goals)
        yield f"Goals: {met} of {known} met, {len(goals) - known} not measured"
        for goal in goals:
            if goal.measured is None:
                continue  # the report names it; here it is one of those counted above
            yield from _wrapped(_goal(goal), width, "  ")
    failures = [each for measured in report.sections for each in measured.failures]
    skips = [each for measured in report.sections for each in measured.skips]
    if failures or skips:
        yield ""
    for failure in failures:
        yield f"FAILED: {failure.what}: {failure.reason}"
    for reason, remedy in dict.fromkeys((skip.reason, skip.remedy) for skip in skips):
        what = "; ".join(
            dict.fromkeys(skip.what for skip in skips if (skip.reason, skip.remedy) == (reason, remedy))
        )
        yield from _wrapped(f"skipped: {what}: {reason}" + (f"; {remedy}" if remedy else ""), width)


def _wrapped(text: str, width: int, indent: str = "") -> list[str]:
    return textwrap.wrap(
        text,
        width,
        initial_indent=indent,
        subsequent_indent=indent + "  ",
        break_long_words=False,
        break_on_hyphens=False,
    )


def _goal(goal: Goal) -> str:
    aim = f"{'at least' if goal.at_least else 'at most'} {goal.limit:g}x"
    word = "met   " if goal.met else "missed"
    found = f"[{word}] {goal.what}: {cell_text(goal.measured)}x, goal: {aim}"
    return found + (f" ({goal.reason})" if goal.reason and not goal.met else "")
