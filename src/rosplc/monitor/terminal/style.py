"""Colours of levels; every colour comes with a mark and a word."""

from __future__ import annotations

import os

from rich.style import Style
from rich.text import Text

from rosplc.harmless import one_line
from rosplc.levels import Level
from rosplc.monitor.cells import event_text, state_text
from rosplc.monitor.picture import ChannelView, Event

__all__ = ["LEVEL_STYLES", "event_line", "plain", "state_cell"]

_COLOURS = {Level.OK: "green", Level.WARN: "yellow", Level.ERROR: "red", Level.STALE: "magenta"}
# Without colours a red would become a grey that is hard to read.
_PLAIN = bool(os.environ.get("NO_COLOR"))

LEVEL_STYLES = {
    level: Style(color=None if _PLAIN else colour, bold=level is not Level.OK)
    for level, colour in _COLOURS.items()
}
"""How a level's mark and word look."""


def plain(text: str, style: str = "") -> Text:
    """Return text that stands for itself: no markup, and nothing that a terminal acts upon."""
    return Text(one_line(text), style=style, no_wrap=True, end="")


def state_cell(view: ChannelView) -> Text:
    """Return mark and word of a channel's state, in its level's colour."""
    return Text(state_text(view), style=LEVEL_STYLES[view.state.level], no_wrap=True, end="")


def event_line(event: Event, clock: str) -> Text:
    """Return an event as a line, its time before it."""
    return Text.assemble(
        (f"{clock} ", "dim"), (one_line(event_text(event)), LEVEL_STYLES[event.level]), end=""
    )
