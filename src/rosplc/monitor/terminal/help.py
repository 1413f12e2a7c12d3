"""What the keys do, and what the states mean."""

from __future__ import annotations

from typing import ClassVar

from textual.app import ComposeResult
from textual.binding import Binding, BindingType
from textual.containers import VerticalScroll
from textual.screen import Screen
from textual.widgets import Footer, Static

__all__ = ["HelpScreen"]

_TEXT = """\
KEYS
  Up Down PgUp PgDn   move
  Enter               the channel's message with live values
  s, r                sort by the next column, the other way round
  /                   only rows with these words; Esc: all again
  w                   only what is wrong
  p                   pause: the picture stands, the machine does not
  Esc                 back
  q, Ctrl-C           quit

STATES, the worst first; what is wrong has a mark before it
X unreadable  the object cannot be used: damaged, or closed to you
X missing     the configuration has it, and there is no object
X dead        bridge or PLC hold it, and do not beat any more
! no bridge   the bridge ended in order, and left the last message
! refused     messages did not fit, within the last ten seconds
! lost        messages were lost where each one counts
~ stale       the newest message is older than stale_after
~ silent      no message yet, for longer than stale_after
! no PLC      no PLC task reads it, or writes it
  looking     watched for too short a time to say who lives
  ok          nothing is wrong

COLUMNS
  per s   messages per second, over the last seconds
  age     time since the newest message
  lost    messages that a reader missed; one that takes the
          newest alone misses by design
  refd    messages that were refused: they do not fit
  PLC     whether the PLC's task beats

Without --config, 1 s without a message towards the PLC is stale,
and towards ROS no silence is. Nothing here writes anything.
"""


class HelpScreen(Screen[None]):
    """Explains keys, states and columns."""

    DEFAULT_CSS = """
    HelpScreen Static { padding: 0 1; }
    """
    BINDINGS: ClassVar[list[BindingType]] = [
        Binding("escape,q,question_mark,f1", "app.pop_screen", "Back", key_display="Esc")
    ]

    def compose(self) -> ComposeResult:
        """Make the text, which scrolls."""
        with VerticalScroll():
            yield Static(_TEXT, markup=False)
        yield Footer()
