"""A report as Markdown: one text for the documentation, the terminal's pager and a web page."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable, Iterator, Mapping
from typing import Any

from rosplc.bench.machine import busy, cores_text
from rosplc.bench.results import Cell, Figure, Goal, Measured, Page, Report, Table
from rosplc.bench.section import Section, render

__all__ = ["body", "cell_text", "goal_lines", "section_text", "table_lines", "text"]


def text(report: Report, sections: Mapping[str, Section], images: str = "", *, figures: bool = True) -> str:
    """Return the report's Markdown.

    Args:
        report: What was measured.
        sections: Every section by name.
        images: The folder of the figures, as the page sees it, with a slash at the end.
        figures: Whether there are any.
    """
    lines = ["# The comparison", "", *body(report, sections, images, figures=figures)]
    return "\n".join(lines).rstrip() + "\n"


def body(
    report: Report, sections: Mapping[str, Section], images: str = "", *, figures: bool = True
) -> list[str]:
    """Return the same without its title, as lines: for a page that says more."""
    lines = [*_machine(report), ""]
    pages = render(report, sections)
    if not figures:
        pages = {name: dataclasses.replace(page, figures=()) for name, page in pages.items()}
    goals = [goal for page in pages.values() for goal in page.goals]
    if goals:
        lines += ["## Goals", "", *goal_lines(goals), ""]
    for measured in report.sections:
        lines += section_text(measured, sections[measured.section], pages[measured.section], images)
    return lines


def section_text(measured: Measured, section: Section, page: Page, images: str) -> list[str]:
    """Return one section's lines."""
    lines = [f"## {section.title}", "", section.question, ""]
    for paragraph in page.lead:
        lines += [paragraph, ""]
    for figure in page.figures:
        lines += [_image(figure, images), ""]
    for table in page.tables:
        lines += [*table_lines(table), ""]
    for paragraph in page.after:
        lines += [paragraph, ""]
    if measured.failures:
        lines += [f"* **Failed: {each.what}**: {each.reason}" for each in measured.failures] + [""]
    if measured.skips:
        lines += [
            f"* Not measured: {each.what}: {each.reason}" + (f" ({each.remedy})" if each.remedy else "")
            for each in measured.skips
        ] + [""]
    return lines


def table_lines(table: Table) -> Iterator[str]:
    """Yield a table's lines: title, rows, and how those wait who wait."""
    rows = [[cell_text(cell) for cell in row] for row in table.rows]
    numeric = [
        all(not isinstance(row[column], str) for row in table.rows) for column in range(len(table.header))
    ]
    yield f"**{table.title}**"
    yield ""
    yield _row(table.header)
    yield _row("---:" if right else "---" for right in numeric)
    for row in rows:
        yield _row(row)
    yield ""
    yield f"*Waiting: {table.waiting}.*" + (f" {table.note}" if table.note else "")


def goal_lines(goals: Iterable[Goal]) -> Iterator[str]:
    """Yield the goals as a table: aimed at, measured, met or not and why."""
    yield "| goal | aimed at | measured | |"
    yield "| --- | ---: | ---: | --- |"
    for goal in goals:
        aim = f"{'≥' if goal.at_least else '≤'} {goal.limit:g} ×"
        found = "" if goal.measured is None else f"{cell_text(goal.measured)} ×"
        word = {True: "met", False: "**missed**", None: "not measured"}[goal.met]
        yield _row(
            (goal.what, aim, found, word + (f": {goal.reason}" if goal.reason and not goal.met else ""))
        )


def cell_text(cell: Cell) -> str:
    """Return a cell as people read it: three significant digits, thousands apart."""
    if cell is None:
        return ""
    if isinstance(cell, float):
        if cell != cell or cell in (float("inf"), float("-inf")):
            return str(cell)
        if abs(cell) >= 999.5:
            return f"{round(cell, -max(0, len(str(int(abs(cell)))) - 3)):,.0f}"

        return f"{cell:#.3g}".rstrip(".") if cell else "0"
    if isinstance(cell, int):
        return f"{cell:,}"
    return cell


def _row(cells: Iterable[str]) -> str:
    return "| " + " | ".join(cell.replace("|", "\\|") for cell in cells) + " |"


def _image(figure: Figure, images: str) -> str:
    return f"![{figure.title}]({images}{figure.name}.svg)"


def _machine(report: Report) -> list[str]:
    facts: Mapping[str, Any] = report.machine
    kind = "virtual machine" if facts["virtual"] else "machine"
    versions = ", ".join(f"{name} {number}" for name, number in facts["versions"].items() if number != "none")
    effort = report.options["effort"]
    shared = " (the two measured on are threads of one core)" if facts.get("threads_of_one_core") else ""
    return [
        f"{facts['processor']}, {kind} with {cores_text(facts)}{shared}, {facts['kernel']}, "
        f"frequency governor {facts['governor']}, on {facts['when']}. Python {facts['python']}, {versions}, "
        f"libmodbus {facts['libmodbus']}, {facts['compiler']}. Load average {_numbers(facts['load_before'])} "
        f"before and {_numbers(facts['load_after'])} after. Effort: {effort['name']}, "
        f"{effort['rounds']} rounds.",
        "",
        *([f"**{remark}**", ""] if (remark := busy(facts)) else []),
        "**Ratios travel between machines, times do not**, and no ratio means anything without how those "
        "waited who waited: it stands below every table.",
    ]


def _numbers(values: Iterable[float]) -> str:
    return ", ".join(f"{value:.2f}" for value in values)
