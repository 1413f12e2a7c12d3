"""A section of the comparison: one question, measured and shown apart from the others."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

from rosplc.bench.context import Context
from rosplc.bench.results import Page, Report
from rosplc.errors import SetupError

__all__ = ["Section", "render"]


@dataclass(frozen=True)
class Section:
    """A question with its measurement.

    Attributes:
        name: How ``--section`` calls it.
        title: Its heading.
        question: What it answers, one sentence.
        run: Measures; returns plain data as JSON holds it (strings as keys). What it cannot measure
            it gives to ``Context.skip``, what goes wrong to ``Context.fail``.
        render: Makes of that data what people read; knows nothing else.
        contenders: The names that ``--only`` may give.
    """

    name: str
    title: str
    question: str
    run: Callable[[Context], dict[str, Any]]
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
            raise SetupError("SYS007", f"this release knows no section {each.section!r}")
        try:
            pages[each.section] = sections[each.section].render(each.data) if each.data else Page()
        except (LookupError, TypeError, ValueError) as error:
            # Only a report that somebody else wrote, or another release, lacks what this one measures.
            what = f"its section {each.section!r} lacks something: {type(error).__name__}: {error}"
            raise SetupError("SYS007", what) from error
    return pages
