"""What the doctor says: findings, each of a kind that the table in :mod:`rosplc.doctor.kinds` knows."""

from __future__ import annotations

import enum
from dataclasses import dataclass, replace
from typing import Any

__all__ = ["Area", "Finding", "Kind", "Level"]


class Level(enum.IntEnum):
    """How much a finding matters; a larger one is worse."""

    OK = 0
    """It was looked at, and is as it should be."""
    NOTE = 1
    """Good to know; nothing has to be done."""
    WARNING = 2
    """It works, or may work, but probably not as it was meant."""
    ERROR = 3
    """It will not work like this."""

    @property
    def word(self) -> str:
        """The word that people and JSON read."""
        return self.name.lower()


class Area(enum.Enum):
    """What a finding is about, in the order in which people read them."""

    DOCTOR = "what the doctor could not do"
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
    """What a code stands for, for the reference page and for findings.

    Attributes:
        code: Three letters and three digits; it never changes its meaning.
        area: What it is about.
        level: How much it matters when it is found.
        title: What is examined, in a few words.
        meaning: What it means when it is found, in a sentence or two.
        remedy: What usually helps; empty where nothing has to be done.
    """

    code: str
    area: Area
    level: Level
    title: str
    meaning: str
    remedy: str

    def found(
        self, seen: str, remedy: str | None = None, command: str = "", *, level: Level | None = None
    ) -> Finding:
        """Return that it was found.

        Args:
            seen: What was seen, one sentence without a full stop at the end.
            remedy: What to do, if not the usual; a full sentence.
            command: The exact command that does it, where there is one.
            level: How much it matters this time, if not the usual.
        """
        wanted = self.level if level is None else level
        return Finding(self.code, self.area, wanted, seen, self.remedy if remedy is None else remedy, command)

    def fine(self, seen: str) -> Finding:
        """Return that it was looked for and that all is well."""
        return Finding(self.code, self.area, Level.OK, seen)


@dataclass(frozen=True)
class Finding:
    """One thing that was looked at.

    Attributes:
        code: Its kind.
        area: What it is about.
        level: How much it matters.
        seen: What was seen.
        remedy: What to do; empty if nothing.
        command: The exact command that does it; empty if there is none.
    """

    code: str
    area: Area
    level: Level
    seen: str
    remedy: str = ""
    command: str = ""

    def at(self, level: Level) -> Finding:
        """Return the same finding at another level."""
        return replace(self, level=level)

    def to_dict(self) -> dict[str, Any]:
        """Return plain data for JSON."""
        return {
            "area": self.area.value,
            "level": self.level.word,
            "code": self.code,
            "seen": self.seen,
            "remedy": self.remedy,
            "command": self.command,
        }
