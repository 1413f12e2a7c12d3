"""Colours of levels; every colour comes with a mark and a word."""

from __future__ import annotations

from rich.style import Style
from rich.text import Text

from rosplc.harmless import one_line
from rosplc.levels import Level
from rosplc.monitor.cells import event_text, state_text
from rosplc.monitor.picture import ChannelView, Event

__all__ = ["LEVEL_STYLES", "event_line", "plain", "state_cell"]

LEVEL_STYLES = {
    Level.OK: Style(color="green"),
    Level.WARN: Style(color="yellow", bold=True),
    Level.ERROR: Style(color="red", bold=True),
    Level.STALE: Style(color="magenta", bold=True),
}


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
