"""What a page wants to see, as it says so; within limits, since anybody may ask."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

from rosplc.errors import WebError
from rosplc.web.paths import parse_path

__all__ = ["MAX_MESSAGES", "MAX_PLOTS", "Wants"]

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
