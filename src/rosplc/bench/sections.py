"""Every section, in the order of the report."""

from __future__ import annotations

from rosplc.bench.experiment import EXPERIMENT
from rosplc.bench.section import Section

__all__ = ["SECTIONS", "find"]

SECTIONS: tuple[Section, ...] = (EXPERIMENT,)


def find(name: str) -> Section:
    """Return the section of a name. Raises KeyError if there is none."""
    return {section.name: section for section in SECTIONS}[name]
