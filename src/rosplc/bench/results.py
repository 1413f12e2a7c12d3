"""What a run of the comparison finds, and how a section shows it.

A section measures once and gives plain data; what people read (tables, figures, goals) is made
from that data alone. So a report can be rendered again from its JSON, and no figure in a page
can be anything but what was measured.
"""

from __future__ import annotations

import dataclasses
import json
from dataclasses import dataclass, field
from typing import Any, TypeAlias

from rosplc.errors import SetupError

__all__ = [
    "SCHEMA",
    "Cell",
    "Failure",
    "Figure",
    "Goal",
    "Measured",
    "Page",
    "Report",
    "Series",
    "Skip",
    "Table",
]

SCHEMA = "rosplc-bench 1"
"""The version of a report's JSON; another number means that old readers would misread it."""

Cell: TypeAlias = str | int | float | None


@dataclass(frozen=True)
class Table:
    """Rows of figures under one waiting strategy.

    Attributes:
        title: What is compared, with the unit.
        header: The columns' names.
        rows: One cell per column; None is left empty, numbers get three significant digits.
        waiting: How those wait who wait: no figure here means anything without it.
        note: What else the reader must know.
    """

    title: str
    header: tuple[str, ...]
    rows: tuple[tuple[Cell, ...], ...]
    waiting: str
    note: str = ""


@dataclass(frozen=True)
class Series:
    """One line of a figure, or one bar: a y for each x.

    Attributes:
        name: In the legend.
        x: For a bar unused.
        y: For a bar one value.
        group: "source" is drawn in grey, "rosplc" stands out, everything else is neither.
    """

    name: str
    x: tuple[float, ...]
    y: tuple[float, ...]
    group: str = field(default="", kw_only=True)


@dataclass(frozen=True)
class Figure:
    """A drawing, as data.

    Attributes:
        name: The file's name, without its ending.
        title: One line above it; says how those wait who wait.
        x_label: With the unit; for bars unused.
        y_label: With the unit.
        series: What is drawn; for ``kind`` "bars" each has one value in ``y``.
        kind: "lines" or "bars" (horizontal, in the order given).
        x_log: Whether the x axis is logarithmic.
        y_log: Whether the y axis is (for bars: the axis of values).
    """

    name: str
    title: str
    x_label: str
    y_label: str
    series: tuple[Series, ...]
    kind: str = "lines"
    x_log: bool = False
    y_log: bool = False


@dataclass(frozen=True)
class Goal:
    """A figure that was aimed at.

    Attributes:
        what: Who is compared with whom, and how both wait.
        limit: The ratio aimed at.
        measured: The ratio found; None if one of the two was not measured.
        at_least: Whether ``limit`` is the least (True) or the most that is good.
        reason: Why it was missed, or why it was not measured.
    """

    what: str
    limit: float
    measured: float | None
    at_least: bool = True
    reason: str = ""

    @property
    def met(self) -> bool | None:
        """Whether the goal is met; None if it was not measured."""
        if self.measured is None:
            return None
        return self.measured >= self.limit if self.at_least else self.measured <= self.limit


@dataclass(frozen=True)
class Page:
    """What a section shows.

    Attributes:
        lead: Paragraphs before the tables.
        tables: In order.
        figures: In order.
        goals: With what was reached.
        after: Paragraphs behind the tables: what the figures mean and what they do not.
        summary: Lines for the terminal's verdict: complete sentences, and rows of a table, which begin with
            a space and fit into 80 columns.
    """

    lead: tuple[str, ...] = ()
    tables: tuple[Table, ...] = ()
    figures: tuple[Figure, ...] = ()
    goals: tuple[Goal, ...] = ()
    after: tuple[str, ...] = ()
    summary: tuple[str, ...] = ()


@dataclass(frozen=True)
class Skip:
    """Something that could not be measured here, why, and what would make it possible."""

    what: str
    reason: str
    remedy: str = ""


@dataclass(frozen=True)
class Failure:
    """Something that went wrong: wrong values, or a process that ended."""

    what: str
    reason: str


@dataclass(frozen=True)
class Measured:
    """What one section found.

    Attributes:
        section: The section's name.
        seconds: How long it took.
        data: Everything measured, as JSON holds it.
        skips: What was left out.
        failures: What went wrong; a report with failures is not good.
    """

    section: str
    seconds: float
    data: dict[str, Any]
    skips: tuple[Skip, ...] = ()
    failures: tuple[Failure, ...] = ()


@dataclass(frozen=True)
class Report:
    """A whole run: the machine, the options, and what each section found."""

    machine: dict[str, Any]
    options: dict[str, Any]
    sections: tuple[Measured, ...] = field(default=())

    @property
    def good(self) -> bool:
        """Whether nothing went wrong; goals have no say in it."""
        return not any(section.failures for section in self.sections)

    def to_dict(self) -> dict[str, Any]:
        """Return the report as JSON holds it."""
        return {"schema": SCHEMA, **dataclasses.asdict(self)}

    @classmethod
    def from_json(cls, text: str, where: str = "") -> Report:
        """Read a report that an earlier run wrote.

        Raises:
            SetupError: SYS007, it is no report, or one of another schema.
        """
        try:
            found = json.loads(text)
            if found["schema"] != SCHEMA:
                raise SetupError("SYS007", f"its schema is {found['schema']!r}, not {SCHEMA!r}", where=where)
            return cls(
                found["machine"], found["options"], tuple(_measured(each) for each in found["sections"])
            )
        except (ValueError, KeyError, TypeError) as error:
            raise SetupError("SYS007", f"it is no report: {error}", where=where) from error


def _measured(found: dict[str, Any]) -> Measured:
    skips = tuple(Skip(**each) for each in found["skips"])
    failures = tuple(Failure(**each) for each in found["failures"])
    return Measured(found["section"], float(found["seconds"]), found["data"], skips, failures)
