"""Every section, in the order of the report."""

from __future__ import annotations

from rosplc.bench.end_to_end import SECTION as END_TO_END
from rosplc.bench.experiment import EXPERIMENT
from rosplc.bench.scan_cycle import SECTION as SCAN_CYCLE
from rosplc.bench.section import Section
from rosplc.bench.sweeps import SECTION as SWEEPS
from rosplc.bench.waiting import WAITING_SECTION

__all__ = ["SECTIONS", "find"]

SECTIONS: tuple[Section, ...] = (EXPERIMENT, WAITING_SECTION, END_TO_END, SCAN_CYCLE, SWEEPS)


def find(name: str) -> Section:
    """Return the section of a name. Raises KeyError if there is none."""
    return {section.name: section for section in SECTIONS}[name]
