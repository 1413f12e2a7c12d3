"""The application: it looks, and gives each look to the screen that is shown."""

from __future__ import annotations

from collections import deque
from contextlib import suppress
from typing import ClassVar

from textual.app import App, ComposeResult, ScreenStackError
from textual.binding import Binding, BindingType
from textual.containers import VerticalScroll
from textual.css.query import NoMatches
from textual.screen import Screen
from textual.widgets import Footer, Static

from rosplc.errors import ChannelError
from rosplc.monitor.picture import Event, Picture
from rosplc.monitor.terminal.message import MessageScreen
from rosplc.monitor.terminal.overview import OverviewScreen
from rosplc.monitor.watch import Watch

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
! no server   no server in ROS is ready for what the PLC calls
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


_EVENTS = 200


class TopApp(App[None]):
    """Shows every channel of the machine until it is left; the caller closes the watch."""

    ENABLE_COMMAND_PALETTE = False
    BINDINGS: ClassVar[list[BindingType]] = [Binding("ctrl+c", "quit", "Quit", show=False, priority=True)]

    def __init__(self, watch: Watch, seconds: float = 0.5) -> None:
        super().__init__()
        self._watch = watch
        self._seconds = seconds
        self._events: deque[Event] = deque(maxlen=_EVENTS)
        self._picture: Picture | None = None
        self._paused = False
        self._trouble = ""
        self._overview = OverviewScreen()

    def on_mount(self) -> None:
        """Begin to look."""
        self.push_screen(self._overview)
        self.call_later(self._look)
        self.set_interval(self._seconds, self._look)

    def on_overview_screen_chosen(self, message: OverviewScreen.Chosen) -> None:
        """Open a channel's message."""
        self.push_screen(MessageScreen(self._watch, message.channel, self._seconds))

    def action_help(self) -> None:
        """Explain keys and states."""
        self.push_screen(HelpScreen())

    def action_pause(self) -> None:
        """Let the picture stand, or go on."""
        self._paused = not self._paused
        self.title = "paused" if self._paused else "rosplc top"
        self._show()

    def _look(self) -> None:
        try:
            picture = self._watch.look()
        except ChannelError as error:
            if self._trouble != error.what:
                self._trouble = error.what
                self.notify(f"{error.what} [{error.code}]", severity="error", markup=False)
            return
        self._trouble = ""
        self._events.extend(picture.events)
        if not self._paused:
            self._picture = picture
            self._show()

    def _show(self) -> None:
        if self._picture is None:
            return
        # A look may come while a screen is being built or taken down: then parts of it are missing, or all.
        with suppress(NoMatches, ScreenStackError):
            if isinstance(self.screen, OverviewScreen):
                self.screen.show(self._picture, list(self._events))
            elif isinstance(self.screen, MessageScreen):
                self.screen.show(self._picture)
