"""Colours of levels; every colour comes with a mark and a word."""

from __future__ import annotations

from rich.text import Text

from rosplc.harmless import one_line
from rosplc.levels import Level
from rosplc.monitor.cells import event_text, state_text
from rosplc.monitor.picture import ChannelView, Event

__all__ = ["event_line", "plain", "right", "shortened", "state_cell"]

_STYLES = {Level.OK: "green", Level.WARN: "bold yellow", Level.ERROR: "bold red", Level.STALE: "bold magenta"}


def plain(text: str, style: str = "") -> Text:
    """Return text that stands for itself: no markup, and nothing that a terminal acts upon."""
    return Text(one_line(text), style=style, no_wrap=True, end="")


def right(text: str, width: int, style: str = "") -> Text:
    """Return a figure in ``width`` cells, standing to the right."""
    return Text(text.rjust(width), style=style, no_wrap=True, end="")


def shortened(text: str, width: int) -> Text:
    """Return a name in ``width`` cells, cut at its beginning: its end is what tells names apart."""
    found = plain(text)
    if found.cell_len <= width:
        return found
    kept = found.plain
    while kept and Text(kept).cell_len > width - 1:
        kept = kept[1:]
    return Text("…" + kept, no_wrap=True, end="")


def state_cell(view: ChannelView) -> Text:
    """Return mark and word of a channel's state, in its level's colour."""
    return Text(state_text(view), style=_STYLES[view.state.level], no_wrap=True, end="")


def event_line(event: Event, clock: str) -> Text:
    """Return an event as a line, its time before it."""
    return Text.assemble((f"{clock} ", "dim"), (one_line(event_text(event)), _STYLES[event.level]), end="")
