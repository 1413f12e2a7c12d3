"""What a page wants to see, as it says so; within limits, since anybody may ask."""

from __future__ import annotations

import re
from dataclasses import dataclass, field
from functools import lru_cache
from typing import Any

from rosplc.errors import WebError

__all__ = ["MAX_MESSAGES", "MAX_PATH", "MAX_PLOTS", "Wants", "number_at", "parse_path"]

MAX_PATH = 300
"""Characters of the longest path that is accepted."""

_STEP = re.compile(r"(?:^|\.)([A-Za-z_][A-Za-z0-9_]*)|\[([0-9]{1,8})\]")


@lru_cache(maxsize=1024)
def parse_path(text: str) -> tuple[str | int, ...]:
    """Return the steps of a path: names of fields and indices of elements.

    Raises:
        ValueError: It is no path.
    """
    steps: list[str | int] = []
    at = 0
    while at < len(text) <= MAX_PATH:
        found = _STEP.match(text, at)
        if found is None or found.end() == at:
            break
        steps.append(found[1] if found[2] is None else int(found[2]))
        at = found.end()
    if not steps or at != len(text):
        raise ValueError(f"{text[:80]!r} is no path of a field")
    return tuple(steps)


def number_at(message: Any, path: str) -> float | int | None:
    """Return the number at a path of a message; None if there is none.

    A bool counts as 0 or 1. NaN and infinities are None: they have no place in a plot.
    """
    value = message
    try:
        for step in parse_path(path):
            value = value[step]
    except (LookupError, TypeError):
        return None
    if not isinstance(value, int | float):
        return None
    value = int(value) if isinstance(value, bool) else value
    return value if value - value == 0 else None


MAX_MESSAGES = 4
"""Messages that one page may have open."""
MAX_PLOTS = 24
"""Fields that one page may plot."""
_MAX_ID = 300


@dataclass(frozen=True)
class Wants:
    """What one page wants.

    Attributes:
        messages: Ids of channels whose newest message it shows.
        plots: Per id the paths of the fields that it plots.
    """

    messages: frozenset[str] = frozenset()
    plots: dict[str, frozenset[str]] = field(default_factory=dict)

    @classmethod
    def of(cls, data: Any) -> Wants:
        """Return what a page's JSON says.

        Raises:
            WebError: WEB009, it has another form, or wants more than one page may.
        """
        if not isinstance(data, dict):
            raise _malformed("what a page wants is an object")
        messages, plots = data.get("messages", []), data.get("plots", {})
        if not isinstance(messages, list) or not isinstance(plots, dict):
            raise _malformed("`messages` is a list, `plots` an object")
        for name in [*messages, *plots]:
            if not isinstance(name, str) or len(name) > _MAX_ID:
                raise _malformed("a channel's id is a text")
        count = 0
        for paths in plots.values():
            if not isinstance(paths, list) or not all(isinstance(path, str) for path in paths):
                raise _malformed("the fields to plot are a list of paths")
            count += len(paths)
            for path in paths:
                try:
                    parse_path(path)
                except ValueError as error:
                    raise _malformed(str(error)) from None
        if len(messages) > MAX_MESSAGES or count > MAX_PLOTS:
            raise _malformed(f"a page may open {MAX_MESSAGES} messages and plot {MAX_PLOTS} fields")
        return cls(frozenset(messages), {name: frozenset(paths) for name, paths in plots.items() if paths})


def _malformed(what: str) -> WebError:
    return WebError("WEB009", what)
