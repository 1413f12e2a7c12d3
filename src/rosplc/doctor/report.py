"""All findings of an examination: their worst, their order, their JSON."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from typing import Any

from rosplc._version import __version__
from rosplc.doctor.finding import Area, Finding, Level

__all__ = ["SCHEMA", "Report"]

SCHEMA = 1
"""Version of the JSON document; keys are only added under the same number."""


@dataclass(frozen=True)
class Report:
    """What an examination found.

    Attributes:
        findings: In the order of the examinations.
        config: The configuration file; None for the machine alone.
    """

    findings: tuple[Finding, ...]
    config: str | None = None

    @property
    def worst(self) -> Level:
        """The worst level."""
        return max((finding.level for finding in self.findings), default=Level.OK)

    @property
    def unusable(self) -> bool:
        """Whether the configuration itself is wrong."""
        return any(finding.code == "DOC501" and finding.level is Level.ERROR for finding in self.findings)

    def counts(self) -> dict[str, int]:
        """Return how many findings there are of each level, the worst first."""
        number = Counter(finding.level for finding in self.findings)
        return {level.word: number[level] for level in sorted(Level, reverse=True)}

    def areas(self) -> list[tuple[Area, list[Finding]]]:
        """Return findings by area: the areas with the worst first, and so within each."""
        groups = {area: [f for f in self.findings if f.area is area] for area in Area}
        filled = [(area, sorted(group, key=lambda f: -f.level)) for area, group in groups.items() if group]
        return sorted(filled, key=lambda item: -item[1][0].level)

    def to_dict(self) -> dict[str, Any]:
        """Return plain data for JSON."""
        return {
            "schema": SCHEMA,
            "rosplc": __version__,
            "config": self.config,
            "worst": self.worst.word,
            "counts": self.counts(),
            "findings": [finding.to_dict() for finding in self.findings],
        }
