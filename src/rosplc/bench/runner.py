"""Run sections one after the other, in a folder of shared memory that is gone afterwards."""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

from rosplc.bench import machine
from rosplc.bench.context import Context, Effort
from rosplc.bench.results import Measured, Report
from rosplc.bench.scratch import scratch_folder
from rosplc.bench.section import Section
from rosplc.errors import RosplcError

__all__ = ["cache_folder", "run"]


def run(
    sections: Sequence[Section],
    effort: Effort,
    *,
    only: Sequence[str] = (),
    notify: Callable[[Section, int, int, str], None] | None = None,
) -> Report:
    """Measure sections and return the report.

    Args:
        sections: What to measure, in order.
        effort: How much.
        only: Names of contenders; empty for all.
        notify: Called with the section, steps done, steps in all, and what is being measured.

    Raises:
        SetupError: SYS008, shared memory cannot be used.
    """
    facts = machine.describe()
    measured = []
    with scratch_folder() as folder:
        for section in sections:
            context = Context(
                effort,
                folder,
                cache_folder(),
                tuple(sorted(os.sched_getaffinity(0))[:2]),
                tuple(only),
            )
            if notify is not None:
                context.notify = _for(section, notify)
            began = time.monotonic()
            data = _data(section, context)
            measured.append(
                Measured(
                    section.name,
                    round(time.monotonic() - began, 2),
                    data,
                    tuple(context.skips),
                    tuple(context.failures),
                )
            )
    facts["load_after"] = machine.load_average()
    return Report(facts, {"effort": asdict(effort), "only": list(only)}, tuple(measured))


def _data(section: Section, context: Context) -> dict[str, Any]:
    try:
        return section.run(context)
    except RosplcError as error:
        # What the other sections find is not lost with this one.
        context.fail(section.name, str(error))
        return {}


def _for(
    section: Section, notify: Callable[[Section, int, int, str], None]
) -> Callable[[int, int, str], None]:
    return lambda done, total, what: notify(section, done, total, what)


def cache_folder() -> Path:
    """Return where compiled programs are kept: ``$XDG_CACHE_HOME/rosplc/bench``."""
    base = os.environ.get("XDG_CACHE_HOME", "")
    return (Path(base) if base.startswith("/") else Path.home() / ".cache") / "rosplc" / "bench"
