"""The application, which gives each look to the screen that is shown, and the first screen: every channel."""

from __future__ import annotations

from collections import deque
from contextlib import suppress
from dataclasses import replace
from datetime import datetime
from typing import ClassVar

from rich.text import Text
from textual.app import App, ComposeResult, ScreenStackError
from textual.binding import Binding, BindingType
from textual.containers import VerticalScroll
from textual.css.query import NoMatches
from textual.events import Resize
from textual.message import Message
from textual.screen import Screen
from textual.widgets import Footer, Input, Static

from rosplc.errors import ChannelError
from rosplc.harmless import one_line
from rosplc.levels import Level
from rosplc.monitor.picture import BridgeView, ChannelView, Event, Picture, event_text, grouped
from rosplc.monitor.terminal.message import MessageScreen
from rosplc.monitor.terminal.table import LEVEL_STYLES, ChannelTable, Sorting, plain
from rosplc.monitor.watch import Watch

_NONE = "There are no channels on this machine. Start a bridge (rosplc run) or the demo (rosplc demo)."
_EVENT_LINES = ((18, 2), (24, 4), (36, 8))


class OverviewScreen(Screen[None]):
    """The first screen."""

    class Chosen(Message):
        """A channel was chosen, to see its message."""

        def __init__(self, channel: ChannelView) -> None:
            super().__init__()
            self.channel = channel

    DEFAULT_CSS = """
    OverviewScreen Static { text-wrap: nowrap; text-overflow: ellipsis; }
    OverviewScreen #head { height: 1; background: $panel; }
    OverviewScreen #nothing { height: auto; padding: 1; display: none; text-wrap: wrap; }
    OverviewScreen #chosen { height: 2; border-top: none; background: $panel; }
    OverviewScreen #events { height: 0; }
    OverviewScreen Input { height: 1; display: none; }
    """
    BINDINGS: ClassVar[list[BindingType]] = [
        Binding("s", "sort", "Sort"),
        Binding("r", "reverse", "Reverse", show=False),
        Binding("slash", "filter", "Filter", key_display="/", priority=True),
        Binding("w", "wrong", "Wrong"),
        Binding("p", "app.pause", "Pause"),
        Binding("question_mark,f1", "app.help", "Help", key_display="?"),
        Binding("q,ctrl+c", "app.quit", "Quit", key_display="q"),
        Binding("escape", "all", "All", show=False),
    ]

    def __init__(self) -> None:
        super().__init__()
        self._order = Sorting()
        self._picture: Picture | None = None
        self._events: list[Event] = []

    def compose(self) -> ComposeResult:
        """Make heading, table, details, events and keys."""
        yield Static(id="head")
        yield Static(_NONE, id="nothing", markup=False)
        yield ChannelTable()
        yield Input(placeholder="words in topic, type, bridge or state", id="filter", compact=True)
        yield Static(id="chosen")
        yield Static(id="events")
        yield Footer()

    def on_mount(self) -> None:
        """Let keys move in the table."""
        self.query_one(ChannelTable).focus()
        self._draw()

    def on_resize(self, event: Resize) -> None:
        """Give events the lines that a screen of this height can spare."""
        lines = max((lines for height, lines in _EVENT_LINES if event.size.height >= height), default=0)
        self.query_one("#events", Static).styles.height = lines
        self._show_events()

    def show(self, picture: Picture, events: list[Event]) -> None:
        """Show a new look, and what happened since the start, the newest last."""
        self._picture, self._events = picture, events
        self._draw()

    def _draw(self) -> None:
        picture = self._picture
        if picture is None:
            return
        shown = self._order.of(picture.channels)
        self.query_one("#nothing").display = not picture.channels
        self.query_one(ChannelTable).show(shown, self._order)
        self._head(picture, len(shown))
        self._details()
        self._show_events()

    def _head(self, picture: Picture, shown: int) -> None:
        wrong = len(picture.wrong)
        text = Text(" rosplc top  ", style="bold", no_wrap=True, overflow="ellipsis")
        count = len(picture.channels)
        text.append(f"{shown} of {count} channels  " if shown != count else f"{count} channels  ", "not bold")
        text.append(
            f"! {wrong} wrong  " if wrong else "all well  ", LEVEL_STYLES[Level.ERROR if wrong else Level.OK]
        )
        if self.app.title == "paused":
            text.append("PAUSED  ", LEVEL_STYLES[Level.WARN])
        if self._order.wrong or self._order.words:
            text.append(f"only: {one_line(self._order.words) or 'wrong'}  ", LEVEL_STYLES[Level.WARN])
        bridges = sorted(picture.bridges, key=lambda bridge: bridge.alive is True)
        text.append(", ".join(_bridge(bridge) for bridge in bridges), "not bold")
        for note in picture.notes:
            text.append(f"  {note}", LEVEL_STYLES[Level.WARN])
        self.query_one("#head", Static).update(text, layout=False)

    def _details(self) -> None:
        view = self.query_one(ChannelTable).chosen
        box = self.query_one("#chosen", Static)
        if view is None:
            box.update("", layout=False)
            return
        place = f" {one_line(view.label)}  {one_line(view.type_name)}  {view.prefix}: {one_line(view.bridge)}"
        readers = ", ".join(
            (one_line(each.task) or f"process {each.pid}") + (" (dead)" if each.alive is False else "")
            for each in view.readers
        )
        code = f" [{view.code}]" if view.code else ""
        words = f" {one_line(view.words)}{code}" + (f"; read by {readers}" if readers else "")
        box.update(Text(f"{place}\n{words}", no_wrap=True, overflow="ellipsis"), layout=False)

    def _show_events(self) -> None:
        box = self.query_one("#events", Static)
        lines = int(box.styles.height.value) if box.styles.height is not None else 0
        if not lines:
            return
        newest = grouped(self._events)[-lines:][::-1]
        text = Text("\n", no_wrap=True, overflow="ellipsis").join(
            Text.assemble(
                (f" {datetime.fromtimestamp(event.time_ns / 1e9):%H:%M:%S} ", "dim"),
                (one_line(event_text(event)), LEVEL_STYLES[event.level]),
                end="",
            )
            for event in newest
        )
        box.update(text if newest else plain(" Nothing happened since the start.", "dim"), layout=False)

    def on_channel_table_highlighted(self, event: ChannelTable.Highlighted) -> None:
        """Tell about the row under the cursor."""
        with suppress(NoMatches):  # the screen goes
            self._details()

    def on_channel_table_opened(self, event: ChannelTable.Opened) -> None:
        """Open the row's message."""
        view = self.query_one(ChannelTable).chosen
        if view is not None:
            self.post_message(self.Chosen(view))

    def on_channel_table_heading_clicked(self, event: ChannelTable.HeadingClicked) -> None:
        """Sort by the column whose heading was clicked."""
        again = event.by == self._order.by
        self._reorder(replace(self._order, by=event.by, reverse=again and not self._order.reverse))

    def on_input_changed(self, event: Input.Changed) -> None:
        """Filter while typing."""
        self._reorder(replace(self._order, words=event.value))

    def on_input_submitted(self, event: Input.Submitted) -> None:
        """Go back to the table, which stays filtered."""
        self._close_filter()

    def action_sort(self) -> None:
        """Sort by the next figure."""
        self._reorder(self._order.next())

    def action_reverse(self) -> None:
        """Sort the other way round."""
        self._reorder(replace(self._order, reverse=not self._order.reverse))

    def action_wrong(self) -> None:
        """Show only what is wrong, or everything again."""
        self._reorder(replace(self._order, wrong=not self._order.wrong))

    def check_action(self, action: str, parameters: tuple[object, ...]) -> bool | None:
        """Let a slash be a letter while words are typed."""
        return action != "filter" or not isinstance(self.focused, Input)

    def action_filter(self) -> None:
        """Ask for words.

        With a binding of priority and without waiting: in "/pose", typed in one piece, the rest must find the
        field.
        """
        field = self.query_one(Input)
        field.display = True
        self.set_focus(field)

    def action_all(self) -> None:
        """Show everything again."""
        self.query_one(Input).value = ""
        self._close_filter()
        self._reorder(replace(self._order, words="", wrong=False))

    def _close_filter(self) -> None:
        self.query_one(Input).display = False
        self.set_focus(self.query_one(ChannelTable))

    def _reorder(self, order: Sorting) -> None:
        self._order = order
        self._draw()


def _bridge(bridge: BridgeView) -> str:
    word = "?" if bridge.alive is None else "alive" if bridge.alive else "DEAD" if bridge.pid else "ENDED"
    return f"{one_line(bridge.name)} {word}"


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
