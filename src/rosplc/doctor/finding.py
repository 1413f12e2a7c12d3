"""What the doctor reports: findings, each of a kind in :mod:`rosplc.doctor.kinds`."""

from __future__ import annotations

import enum
import grp
import pwd
from collections import Counter
from dataclasses import dataclass
from typing import Any

from rosplc._version import __version__

SCHEMA = 1  # version of the JSON document; keys are only added under the same number


class Level(enum.IntEnum):
    """The severity of a finding; a larger value is more severe."""

    OK = 0  # it was looked at, and is as it should be
    NOTE = 1  # good to know; nothing has to be done
    WARNING = 2  # it works, or may work, but probably not as it was meant
    ERROR = 3  # it will not work like this

    @property
    def word(self) -> str:
        """The level as a word, for people and for JSON."""
        return self.name.lower()


class Area(enum.Enum):
    """The subjects of findings, in the order in which the report lists them."""

    DOCTOR = "failed examinations"
    MACHINE = "machine"
    MEMORY = "shared memory"
    PLC = "PLC runtime"
    ROS = "ROS environment"
    CONFIG = "configuration"
    GRAPH = "ROS graph"
    LIVE = "running bridge"
    CODE = "PLC code"


@dataclass(frozen=True)
class Kind:
    """The meaning of a ``code``, which never changes, for the reference page and for findings.

    ``level`` is the usual severity of the finding, ``title`` its subject, ``meaning`` its explanation, and
    ``remedy`` what usually helps, empty if no action is needed.
    """

    code: str
    area: Area
    level: Level
    title: str
    meaning: str
    remedy: str


@dataclass(frozen=True)
class Finding:
    """The result of one check: what was seen, what to do, and the command for it (may be empty)."""

    code: str
    area: Area
    level: Level
    seen: str
    remedy: str = ""
    command: str = ""

    def to_dict(self) -> dict[str, Any]:
        """Return plain data for JSON."""
        texts = {"code": self.code, "seen": self.seen, "remedy": self.remedy, "command": self.command}
        return {"area": self.area.value, "level": self.level.word, **texts}


@dataclass(frozen=True)
class Report:
    """The findings in the order of the examinations; ``config`` is None for the machine alone."""

    findings: tuple[Finding, ...]
    config: str | None = None

    @property
    def worst(self) -> Level:
        """The most severe level."""
        return max((finding.level for finding in self.findings), default=Level.OK)

    @property
    def unusable(self) -> bool:
        """Whether the configuration itself is wrong."""
        return any(finding.code == "DOC501" and finding.level is Level.ERROR for finding in self.findings)

    def counts(self) -> dict[str, int]:
        """Return the number of findings of each level, the most severe level first."""
        number = Counter(finding.level for finding in self.findings)
        return {level.word: number[level] for level in sorted(Level, reverse=True)}

    def areas(self) -> list[tuple[Area, list[Finding]]]:
        """Return the findings by area, the most severe first, both among the areas and within each."""
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


def user_name(uid: int) -> str:
    """Return a user's name, or the user's number if it has no name on this machine."""
    try:
        return pwd.getpwuid(uid).pw_name
    except KeyError:
        return f"user {uid}"


def group_name(gid: int) -> str:
    """Return a group's name, or the group's number if it has no name on this machine."""
    try:
        return grp.getgrgid(gid).gr_name
    except KeyError:
        return f"group {gid}"
