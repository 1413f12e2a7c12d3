"""What a run of the comparison finds, and how people read it: pages, files and a summary.

A section measures once and gives plain data; tables and figures are made from that data alone. So a report
can be rendered again from its JSON, and every figure on a page is a measured one.
"""

from __future__ import annotations

import dataclasses
import json
import math
import re
import statistics
import tempfile
import textwrap
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from typing import Any

from rosplc.errors import SetupError
from rosplc_bench import draw
from rosplc_bench.draw import Cell, Figure, cell_text
from rosplc_bench.machine import busy, cores_text

SCHEMA = "rosplc-bench 1"
"""The version of a report's JSON."""


@dataclass(frozen=True)
class Table:
    """Rows of figures under one waiting strategy.

    Attributes:
        title: What is compared, with the unit.
        header: The columns' names.
        rows: One cell per column; None is left empty, numbers get three significant digits.
        waiting: How each side waits: no figure here means anything without it.
        note: What else the reader must know.
    """

    title: str
    header: tuple[str, ...]
    rows: tuple[tuple[Cell, ...], ...]
    waiting: str
    note: str = ""


@dataclass(frozen=True)
class Page:
    """What a section shows.

    Attributes:
        lead: Paragraphs before the tables.
        tables: In order.
        figures: In order.
        after: Paragraphs behind the tables: what the figures mean and what they do not.
        summary: Lines for the terminal: complete sentences, and rows of a table, which begin with a space and
            fit into 80 columns.
    """

    lead: tuple[str, ...] = ()
    tables: tuple[Table, ...] = ()
    figures: tuple[Figure, ...] = ()
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
        """Whether nothing went wrong."""
        return not any(section.failures for section in self.sections)

    def to_dict(self) -> dict[str, Any]:
        """Return the report as JSON holds it."""
        return {"schema": SCHEMA, **dataclasses.asdict(self)}

    @classmethod
    def from_json(cls, text: str, where: str = "") -> Report:
        """Read a report that an earlier run wrote.

        Raises:
            SetupError: SYS007, it is not a report, or has another schema.
        """
        try:
            found = json.loads(text)
            if found["schema"] != SCHEMA:
                raise SetupError("SYS007", f"its schema is {found['schema']!r}, not {SCHEMA!r}", where=where)
            return cls(
                found["machine"], found["options"], tuple(_measured(each) for each in found["sections"])
            )
        except (ValueError, KeyError, TypeError) as error:
            raise SetupError("SYS007", f"not a report: {error}", where=where) from error


def _measured(found: dict[str, Any]) -> Measured:
    skips = tuple(Skip(**each) for each in found["skips"])
    failures = tuple(Failure(**each) for each in found["failures"])
    return Measured(found["section"], float(found["seconds"]), found["data"], skips, failures)


@dataclass(frozen=True)
class Section:
    """A question with its measurement.

    Attributes:
        name: Its name for ``--section``.
        title: Its heading.
        question: What it answers, one sentence.
        run: Measures, given a :class:`rosplc_bench.run.Context`; returns plain data as JSON holds it (strings
            as keys). What it cannot measure it gives to ``Context.skip``, what goes wrong to
            ``Context.fail``.
        render: Makes a page of that data alone.
        contenders: The names that ``--only`` may give.
    """

    name: str
    title: str
    question: str
    run: Callable[[Any], dict[str, Any]]
    render: Callable[[Mapping[str, Any]], Page]
    contenders: tuple[str, ...] = ()


def render(report: Report, sections: Mapping[str, Section]) -> dict[str, Page]:
    """Return what every section of a report shows; one that measured nothing shows nothing.

    Raises:
        SetupError: SYS007, the report has a section that this release does not know.
    """
    pages = {}
    for each in report.sections:
        if each.section not in sections:
            raise SetupError("SYS007", f"this release does not have a section {each.section!r}")
        try:
            pages[each.section] = sections[each.section].render(each.data) if each.data else Page()
        except (LookupError, TypeError, ValueError) as error:
            # Only a report that another release or somebody else wrote lacks what this one measures.
            what = f"its section {each.section!r} is incomplete: {type(error).__name__}: {error}"
            raise SetupError("SYS007", what) from error
    return pages


# Texts


@cache
def _texts() -> dict[str, str]:
    parts = re.split(
        r"^## (.+)\n", Path(__file__).with_name("texts.md").read_text("utf-8"), flags=re.MULTILINE
    )
    return dict(zip(parts[1::2], parts[2::2], strict=True))


def paragraphs(key: str, **values: object) -> tuple[str, ...]:
    """Return the paragraphs of ``texts.md`` with this key, filled in."""
    return tuple(" ".join(each.split()) for each in _texts()[key].strip().format(**values).split("\n\n"))


def text(key: str, **values: object) -> str:
    """Return the same as one paragraph."""
    return " ".join(paragraphs(key, **values))


# Statistics

PERCENTILES = {"p50": 500, "p99": 990, "p999": 999}
"""Name and thousandths."""
ENOUGH = {"p50": 1, "p99": 100, "p999": 1000}
"""So many values a percentile needs to be anything but the largest."""


def percentile(values: Iterable[float], percent: float) -> float:
    """Return the measured value that ``percent`` of the values do not exceed."""
    ordered = sorted(values)
    # In whole thousandths: 0.999 x 1000 in binary fractions is more than 999.
    rank = -(-len(ordered) * round(10 * percent) // 1000)
    return ordered[max(0, rank - 1)]


def distribution(spent_ns: Iterable[float]) -> dict[str, Any]:
    """Return count, p50, p99, p99.9 and max of times in nanoseconds, as microseconds."""
    values = sorted(spent_ns)
    found = {f"{name}_us": percentile(values, share / 10) / 1000 for name, share in PERCENTILES.items()}
    return {"count": len(values), **found, "max_us": values[-1] / 1000}


def shown(found: Mapping[str, Any], name: str) -> float | None:
    """Return a percentile of a :func:`distribution`; None if there are too few values for it."""
    return float(found[f"{name}_us"]) if found["count"] >= ENOUGH[name] else None


def median_ratio(these: Sequence[float], those: Sequence[float]) -> float:
    """Return the median of the ratios of values of the same round; a round that one lacks is left out."""
    return statistics.median(a / b for a, b in zip(these, those, strict=False))


def median(values: Iterable[float]) -> float | None:
    """Return the median of the finite values; None if there are none."""
    found = [value for value in values if math.isfinite(value)]
    return statistics.median(found) if found else None


# Markdown


def markdown(
    report: Report, sections: Mapping[str, Section], images: str = "", *, figures: bool = True
) -> str:
    """Return the report's Markdown.

    Args:
        report: What was measured.
        sections: Every section by name.
        images: The folder of the figures, as the page sees it, with a slash at the end.
        figures: Whether there are any.
    """
    lines = ["# The comparison", "", *markdown_body(report, sections, images, figures=figures)]
    return "\n".join(lines).rstrip() + "\n"


def markdown_body(
    report: Report, sections: Mapping[str, Section], images: str = "", *, figures: bool = True
) -> list[str]:
    """Return the same without its title, as lines: for a page that says more."""
    lines = [*_machine(report), ""]
    for measured, page in zip(report.sections, render(report, sections).values(), strict=True):
        section = sections[measured.section]
        blocks = [f"## {section.title}", section.question, *page.lead]
        blocks += [f"![{each.title}]({images}{each.name}.svg)" for each in page.figures if figures]
        blocks += ["\n".join(table_lines(table)) for table in page.tables]
        blocks += page.after
        blocks += ["\n".join(f"* **Failed: {each.what}**: {each.reason}" for each in measured.failures)]
        blocks += [
            "\n".join(
                f"* Not measured: {each.what}: {each.reason}" + (f" ({each.remedy})" if each.remedy else "")
                for each in measured.skips
            )
        ]
        lines += [line for block in blocks if block for line in (*block.split("\n"), "")]
    return lines


def table_lines(table: Table) -> Iterator[str]:
    """Yield a table's lines: title, rows, and how each side waits."""
    numeric = [
        all(not isinstance(row[column], str) for row in table.rows) for column in range(len(table.header))
    ]
    yield f"**{table.title}**"
    yield ""
    yield _row(table.header)
    yield _row("---:" if right else "---" for right in numeric)
    for row in table.rows:
        yield _row(map(cell_text, row))
    yield ""
    yield f"*Waiting: {table.waiting}.*" + (f" {table.note}" if table.note else "")


def _row(cells: Iterable[str]) -> str:
    return "| " + " | ".join(cell.replace("|", "\\|") for cell in cells) + " |"


def _machine(report: Report) -> list[str]:
    facts: Mapping[str, Any] = report.machine
    kind = "virtual machine" if facts["virtual"] else "machine"
    versions = ", ".join(f"{name} {number}" for name, number in facts["versions"].items() if number != "none")
    effort = report.options["effort"]
    shared = " (the two used are threads of one core)" if facts.get("threads_of_one_core") else ""
    load = [", ".join(f"{value:.2f}" for value in facts[f"load_{when}"]) for when in ("before", "after")]
    return [
        f"{facts['processor']}, {kind} with {cores_text(facts)}{shared}, {facts['kernel']}, "
        f"frequency governor {facts['governor']}, measured on {facts['when']}. "
        f"Python {facts['python']}, {versions}, libmodbus {facts['libmodbus']}, {facts['compiler']}. "
        f"Load average: {load[0]} before the run, {load[1]} after it. "
        f"Effort: {effort['name']}, {effort['rounds']} rounds.",
        "",
        *([f"**{remark}**", ""] if (remark := busy(facts)) else []),
        "**Ratios carry over to other machines; times do not.** A ratio means little unless you know "
        "how each side waited. The line below each table describes this.",
    ]


# Files


def prepare(folder: Path) -> None:
    """Make a report's folder, before time is spent on measuring.

    Raises:
        SetupError: SYS005, it cannot be made or written.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
        # What a file system really allows shows only when something is written.
        with tempfile.TemporaryFile(dir=folder):
            pass
    except OSError as error:
        raise SetupError("SYS005", f"cannot write: {error.strerror}", where=str(folder)) from error


def write(report: Report, sections: Mapping[str, Section], folder: Path) -> list[Path]:
    """Write the report into a folder, which is made if it does not exist; return the files.

    Figures are left out where matplotlib is missing, and the page then shows none.

    Raises:
        SetupError: SYS005, the folder cannot be written.
    """
    prepare(folder)
    try:
        written = [folder / "report.json", folder / "report.md"]
        written[0].write_text(json.dumps(report.to_dict(), indent=1) + "\n", encoding="utf-8")
        written[1].write_text(markdown(report, sections, figures=draw.available()), encoding="utf-8")
        if draw.available():
            for page in render(report, sections).values():
                for figure in page.figures:
                    written += draw.draw(figure, folder)
    except OSError as error:
        raise SetupError("SYS005", f"cannot write: {error.strerror}", where=str(folder)) from error
    return written


# The terminal


def summary(report: Report, sections: Mapping[str, Section], width: int = 80) -> Iterator[str]:
    """Yield the lines for the terminal: what this machine gives, what failed and what was left out.

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
    for name, page in render(report, sections).items():
        if page.summary:
            yield ""
            yield sections[name].title
        for line in page.summary:
            # A table's row keeps its columns; a sentence is broken where the terminal ends.
            yield from ([line] if line.startswith(" ") or not line else _wrapped(line, width, "  "))
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
