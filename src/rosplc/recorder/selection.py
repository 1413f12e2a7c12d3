"""Which topics are meant: names and patterns, as a shell matches file names."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from fnmatch import fnmatchcase

__all__ = ["Selection"]


@dataclass(frozen=True)
class Selection:
    """What is taken and what is left out.

    Attributes:
        topics: Names or patterns such as ``/robot1/*``; empty for all. A ``*`` also matches slashes.
        exclude: Names or patterns that are left out all the same.
    """

    topics: tuple[str, ...] = ()
    exclude: tuple[str, ...] = ()

    def __contains__(self, topic: str) -> bool:
        """Return whether a topic is meant."""
        if any(fnmatchcase(topic, _absolute(one)) for one in self.exclude):
            return False
        return not self.topics or any(fnmatchcase(topic, _absolute(one)) for one in self.topics)

    def without_match(self, topics: Iterable[str]) -> list[str]:
        """Return what was asked for and matches none of these topics."""
        names = list(topics)
        return [one for one in self.topics if not any(fnmatchcase(name, _absolute(one)) for name in names)]


def _absolute(pattern: str) -> str:
    return pattern if pattern.startswith(("/", "*")) else f"/{pattern}"
