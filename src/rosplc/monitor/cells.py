"""The figures of a channel as short texts: for a table, a terminal, a page."""

from __future__ import annotations

from rosplc.levels import Level, format_age
from rosplc.monitor.picture import ChannelView, Event

__all__ = ["MARKS", "age_text", "count_text", "event_text", "plc_text", "rate_text", "state_text", "way_text"]

MARKS = {Level.OK: " ", Level.WARN: "!", Level.ERROR: "X", Level.STALE: "~"}
"""One character per level, for those who cannot tell colours, in any character set."""


def state_text(view: ChannelView) -> str:
    """Return mark and word of the state: ``X dead``."""
    return f"{MARKS[view.state.level]} {view.state.value}"


def rate_text(rate_hz: float | None) -> str:
    """Return a rate in Hz with three digits; ``-`` while it is not known."""
    if rate_hz is None:
        return "-"
    return f"{rate_hz:.0f}" if rate_hz >= 100 or rate_hz == 0 else f"{rate_hz:.3g}"


def age_text(age_ns: int | None) -> str:
    """Return an age: ``12 ms``, ``1.2 s``, ``14 s``, ``3 min``; ``never`` before the first message."""
    if age_ns is None:
        return "never"
    if age_ns < 100_000_000:
        return f"{age_ns // 1_000_000} ms"
    return format_age(age_ns)


def count_text(count: int) -> str:
    """Return a counter in at most five characters: ``99999``, ``12.3M``."""
    if count < 100_000:
        return str(count)
    for unit in "kMG":
        count_in = count / 1000
        if count_in < 999.5 or unit == "G":
            return f"{count_in:.0f}{unit}" if count_in >= 100 else f"{count_in:.3g}{unit}"
        count = round(count_in)
    raise AssertionError  # the loop returns


def plc_text(view: ChannelView) -> str:
    """Return how the PLC's side of a channel is: ``alive``, ``dead``, ``none`` or ``?``."""
    if view.plc_alive:
        return "alive"
    if view.plc_alive is None:
        return "-" if view.classic else "?"
    return "dead" if view.plc_claimed else "none"


def way_text(view: ChannelView) -> str:
    """Return where the messages go."""
    return {"to_plc": "→ PLC", "to_ros": "→ ROS"}.get(view.direction, "?")


def event_text(event: Event) -> str:
    """Return an event's place and words, without its time."""
    place = f"{event.topic}: " if event.topic else ""
    return f"{MARKS[event.level]} {place}{event.words}"
