"""The application and its screens; each new look is given to the current screen."""

from __future__ import annotations

import math
from collections import deque
from contextlib import suppress
from dataclasses import replace
from datetime import datetime
from typing import Any, ClassVar

from rich.text import Text
from textual.app import App, ComposeResult, ScreenStackError
from textual.binding import Binding, BindingType
from textual.containers import Vertical, VerticalScroll
from textual.css.query import NoMatches
from textual.events import Resize
from textual.message import Message
from textual.screen import Screen
from textual.widgets import Footer, Input, Sparkline, Static, Tree
from textual.widgets.tree import TreeNode

from rosplc.errors import ChannelError
from rosplc.harmless import one_line
from rosplc.layout.view import Excerpt
from rosplc.levels import Level
from rosplc.monitor.message import Message as Received
from rosplc.monitor.message import numbers
from rosplc.monitor.picture import (
    BridgeView,
    ChannelView,
    Event,
    Picture,
    age_text,
    count_text,
    event_text,
    grouped,
    plc_text,
    rate_text,
    way_text,
)
from rosplc.monitor.terminal.table import LEVEL_STYLES, ChannelTable, Sorting, plain, state_cell
from rosplc.monitor.watch import Watch

_LOOKS = 600
_FIELDS = 2000


class Course(Vertical):
    """Shows the history of one number."""

    DEFAULT_CSS = """
    Course { height: 4; }
    Course Sparkline { height: 2; width: 1fr; }
    Course Static { height: 1; }
    """

    def compose(self) -> ComposeResult:
        """Create heading, bars and figures."""
        yield Static("", id="course-name")
        yield Sparkline([], id="course-bars")
        yield Static("", id="course-figures")

    def show(self, path: str, values: list[float], seconds: float) -> None:
        """Show a number's history: one value per look, oldest first (empty if it is not a number)."""
        name = self.query_one("#course-name", Static)
        bars = self.query_one("#course-bars", Sparkline)
        figures = self.query_one("#course-figures", Static)
        shown = values[-max(1, self.size.width) :]
        if not shown:
            name.update(Text("This field is not a number", style="dim"))
            figures.update("")
            bars.data = []
            return
        low, high, now = min(shown), max(shown), shown[-1]
        name.update(Text.assemble((one_line(path), "bold"), f"  {now:.6g}"), layout=False)
        span = f"min {low:.6g}  max {high:.6g}  over {len(shown) * seconds:.0f} s"
        figures.update(Text(span, style="dim"), layout=False)
        # Bars begin at the lowest value: a steady number is a flat line, whatever its size.
        bars.data = [value - low for value in shown] if high > low else [0.0] * len(shown)


ELEMENTS = 64  # so many elements of an array are shown

_PREVIEW = 12
_LONGEST_TEXT = 300


class ValueTree(Tree[str]):
    """Shows nested values; a node's data is its path, ``pose.position.x`` or ``ranges[3]``.

    Labels change in place, so open nodes stay open and the cursor keeps its position.
    """

    def __init__(self) -> None:
        super().__init__("", data="")
        self.show_root = False
        self.guide_depth = 2
        self._known: dict[str, TreeNode[str]] = {}
        self._labels: dict[str, str] = {}
        self._items: dict[str, Any] = {}
        self._shape: object = None

    def show(self, values: dict[str, Any], shape: object) -> None:
        """Show a message's values; if ``shape`` differs from the last one, the tree is rebuilt."""
        if shape != self._shape:
            self._shape = shape
            self.clear()
            self.root.expand()
            self._known = {"": self.root}
            self._labels.clear()
        self._items = {"": values}
        self._update(self.root, "", values)

    def on_tree_node_expanded(self, event: Tree.NodeExpanded[str]) -> None:
        """Fill the opened node."""
        path = event.node.data or ""
        if path in self._items:
            self._update(event.node, path, self._items[path])

    def _update(self, node: TreeNode[str], path: str, value: Any) -> None:
        if not node.is_expanded:
            return
        items = _items(path, value)
        for child in list(node.children):
            if child.data not in items:
                self._forget(child.data or "")
                child.remove()
        for child_path, (name, item) in items.items():
            self._items[child_path] = item
            inner = isinstance(item, (dict, list)) and bool(item)
            known = self._known.get(child_path)
            if known is not None and known.allow_expand != inner:
                self._forget(child_path)
                known.remove()
                known = None
            if known is None:
                # A message's own structs open by themselves; arrays may be long.
                opened = isinstance(item, dict) and path.count(".") < 2
                known = node.add("", data=child_path, expand=opened and inner, allow_expand=inner)
                self._known[child_path] = known
            shown = _shown(item)
            if self._labels.get(child_path) != shown:
                self._labels[child_path] = shown
                known.set_label(Text.assemble((name, "bold"), " ", shown, no_wrap=True, end=""))
            if inner:
                self._update(known, child_path, item)

    def _forget(self, path: str) -> None:
        for known in [
            known for known in self._known if known == path or known.startswith((path + ".", path + "["))
        ]:
            del self._known[known]
            self._labels.pop(known, None)


def _items(path: str, value: Any) -> dict[str, tuple[str, Any]]:
    if isinstance(value, dict):
        return {f"{path}.{name}" if path else name: (name, item) for name, item in value.items()}
    if isinstance(value, list):
        return {f"{path}[{index}]": (f"[{index}]", item) for index, item in enumerate(value[:ELEMENTS])}
    return {}


def _shown(value: Any) -> str:
    if isinstance(value, dict):
        return ""
    if isinstance(value, list):
        length = value.length if isinstance(value, Excerpt) else len(value)
        if value and isinstance(value[0], (dict, list)):
            return f"({length})"
        words = ", ".join(_shown(item) for item in value[:_PREVIEW])
        return f"({length}) {words}" + (", …" if length > _PREVIEW else "")
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, float):
        return f"{value:.6g}" if math.isfinite(value) else str(value)
    if isinstance(value, str):
        return one_line(repr(value if len(value) <= _LONGEST_TEXT else value[:_LONGEST_TEXT] + "…"))
    return str(value)


_SHARE = 10


class MessageScreen(Screen[None]):
    """Shows one channel; ``seconds`` is the time between two looks."""

    DEFAULT_CSS = """
    MessageScreen Static { text-wrap: nowrap; text-overflow: ellipsis; }
    MessageScreen #channel-head { height: 1; background: $panel; }
    MessageScreen #channel-state { height: 1; }
    MessageScreen #channel-words { height: 1; }
    MessageScreen #channel-message { height: 1; }
    MessageScreen ValueTree { height: 1fr; border: none; padding: 0; background: $background; }
    """
    BINDINGS: ClassVar[list[BindingType]] = [
        Binding("escape,q,backspace", "app.pop_screen", "Back", key_display="Esc"),
        Binding("p", "app.pause", "Pause"),
        Binding("question_mark,f1", "app.help", "Help", key_display="?"),
    ]

    def __init__(self, watch: Watch, channel: ChannelView, seconds: float) -> None:
        super().__init__()
        self._watch, self._clock = watch, watch.clock
        self._channel = channel
        self._seconds = seconds
        # The last values of every number of a message, one per look.
        self._history: dict[str, deque[float]] = {}
        self._path = ""
        self._shape: object = None
        self._next = 0

    def compose(self) -> ComposeResult:
        """Create heading, tree, history and keys."""
        yield Static(id="channel-head")
        yield Static(id="channel-state")
        yield Static(id="channel-words")
        yield Static(id="channel-message")
        yield ValueTree()
        yield Course()
        yield Footer()

    def on_mount(self) -> None:
        """Show the data that is already available."""
        self.query_one(ValueTree).focus()
        self._head()
        self._take()

    def on_tree_node_highlighted(self, event: Tree.NodeHighlighted[str]) -> None:
        """Show the history of the number under the cursor."""
        if (event.node.data or "") in self._history:
            self._path = event.node.data or ""
            with suppress(NoMatches):  # the screen goes
                self._draw_course()

    def show(self, picture: Picture) -> None:
        """Show a new look."""
        found = picture.channel(self._channel.id)
        if found is None:
            self.query_one("#channel-state", Static).update(Text("X gone", style=LEVEL_STYLES[Level.ERROR]))
            self._say("the channel no longer exists; these are its last values")
            return
        self._channel = found
        self._head()
        if self._clock.monotonic_ns() >= self._next:
            self._take()

    def _head(self) -> None:
        view = self._channel
        self.query_one("#channel-head", Static).update(
            Text.assemble((one_line(view.label), "bold"), f"  {way_text(view)}  ", one_line(view.type_name)),
            layout=False,
        )
        figures = (
            f"  {rate_text(view.rate_hz)} per s  age {age_text(view.age_ns)}  lost {count_text(view.lost)}"
            f"  refused {count_text(view.refused)}  PLC {plc_text(view)}"
        )
        self.query_one("#channel-state", Static).update(
            Text.assemble(state_cell(view), figures), layout=False
        )
        self._say(view.words)

    def _take(self) -> None:
        began = self._clock.monotonic_ns()
        try:
            message = self._watch.message(self._channel, ELEMENTS)
        except ChannelError as error:
            self._say(f"{error.what} [{error.code}]; these are the last values")
            return
        finally:
            # A large message takes its time: no more than a tenth of it is spent on decoding.
            now = self._clock.monotonic_ns()
            self._next = now + _SHARE * (now - began)
        if message is None:
            self._say("no message yet")
            return
        shape = (message.type_name, self._channel.layout_id)
        if shape != self._shape:
            self._shape = shape
            self._history.clear()
        for path, number in numbers(message.values):
            if path in self._history or len(self._history) < _FIELDS:
                self._history.setdefault(path, deque(maxlen=_LOOKS)).append(number)
        if self._path not in self._history:  # the first number that is no part of a header
            names = [path for path in self._history if "header." not in path]
            self._path = next(iter(names or self._history), "")
        self.query_one(ValueTree).show(message.values, shape)
        self.query_one("#channel-message", Static).update(plain(_about(message), "dim"), layout=False)
        self._draw_course()

    def _draw_course(self) -> None:
        self.query_one(Course).show(self._path, list(self._history.get(self._path, ())), self._seconds)

    def _say(self, words: str) -> None:
        self.query_one("#channel-words", Static).update(plain(words), layout=False)


def _about(message: Received) -> str:
    words = [f"message {message.sequence}"] if message.sequence else []
    if message.clock == "system":
        stamp = datetime.fromtimestamp(message.stamp_ns % (1 << 62) / 1e9)
        words.append(f"stamped {stamp:%H:%M:%S.%f}"[:-3])
    elif message.clock:
        words.append(f"stamped {message.stamp_ns / 1e9:.3f} s by the {message.clock} clock")
    return "  ".join([*words, *message.marks])


_NONE = "There are no channels on this machine. Start a bridge (rosplc run) or the demo (rosplc demo)."
_EVENT_LINES = ((18, 2), (24, 4), (36, 8))


class OverviewScreen(Screen[None]):
    """The first screen."""

    class Chosen(Message):
        """A channel was chosen, to show its message."""

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
        """Create heading, table, details, events and keys."""
        yield Static(id="head")
        yield Static(_NONE, id="nothing", markup=False)
        yield ChannelTable()
        yield Input(placeholder="text in topic, type, bridge or state", id="filter", compact=True)
        yield Static(id="chosen")
        yield Static(id="events")
        yield Footer()

    def on_mount(self) -> None:
        """Give the table the keyboard focus."""
        self.query_one(ChannelTable).focus()
        self._draw()

    def on_resize(self, event: Resize) -> None:
        """Adjust the number of event lines to the height of the screen."""
        lines = max((lines for height, lines in _EVENT_LINES if event.size.height >= height), default=0)
        self.query_one("#events", Static).styles.height = lines
        self.call_after_refresh(self._draw)

    def show(self, picture: Picture, events: list[Event]) -> None:
        """Show a new look, and the events since the start, newest last."""
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
            f"! {wrong} not OK  " if wrong else "all OK  ", LEVEL_STYLES[Level.ERROR if wrong else Level.OK]
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
        box.update(text if newest else plain(" No events since the start.", "dim"), layout=False)

    def on_data_table_row_highlighted(self, event: ChannelTable.RowHighlighted) -> None:
        """Show details of the row under the cursor."""
        with suppress(NoMatches):  # the screen goes
            self._details()

    def on_data_table_row_selected(self, event: ChannelTable.RowSelected) -> None:
        """Show the row's message."""
        view = self.query_one(ChannelTable).chosen
        if view is not None:
            self.post_message(self.Chosen(view))

    def on_data_table_header_selected(self, event: ChannelTable.HeaderSelected) -> None:
        """Sort by the column whose heading was clicked."""
        by = event.column_key.value or ""
        again = by == self._order.by
        self._reorder(replace(self._order, by=by, reverse=again and not self._order.reverse))

    def on_input_changed(self, event: Input.Changed) -> None:
        """Filter while typing."""
        self._reorder(replace(self._order, words=event.value))

    def on_input_submitted(self, event: Input.Submitted) -> None:
        """Return to the table, which stays filtered."""
        self._close_filter()

    def action_sort(self) -> None:
        """Sort by the next column."""
        self._reorder(self._order.next())

    def action_reverse(self) -> None:
        """Reverse the sort order."""
        self._reorder(replace(self._order, reverse=not self._order.reverse))

    def action_wrong(self) -> None:
        """Show only channels with a problem, or all channels again."""
        self._reorder(replace(self._order, wrong=not self._order.wrong))

    def check_action(self, action: str, parameters: tuple[object, ...]) -> bool | None:
        """Treat a slash as text while a filter is typed."""
        return action != "filter" or not isinstance(self.focused, Input)

    def action_filter(self) -> None:
        """Ask for filter words.

        The binding has priority and does not wait: if "/pose" is typed quickly, the remaining characters must
        reach the field.
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
  s, r                sort by the next column; reverse the order
  /                   only rows with this text; Esc: all rows
  w                   only channels with a problem
  p                   pause the display; the machine keeps running
  Esc                 back
  q, Ctrl-C           quit

STATES, worst first; a mark precedes each problem
X unreadable  the object is damaged, or access to it is denied
X missing     the topic is configured, but has no object
X dead        the heartbeat of its bridge or PLC has stopped
! no bridge   the bridge was stopped; its last message remains
! refused     within the last ten seconds, messages did not fit
! lost        messages that should be read were lost
~ stale       the newest message is older than stale_after
~ silent      no message has arrived within stale_after
! no PLC      no PLC task reads or writes it
! no server   no ROS server is ready for calls from the PLC
  looking     not yet watched long enough to see a heartbeat
  ok          nothing is wrong

COLUMNS
  per s   messages per second, over the last few seconds
  age     time since the newest message
  lost    messages that a reader missed; a reader that takes
          only the newest misses some by design
  refd    messages that were refused because they did not fit
  PLC     whether the PLC task sends a heartbeat

Without --config, a channel to the PLC is stale after 1 s without a
message; a channel to ROS never is. This program is read-only.
"""


class HelpScreen(Screen[None]):
    """Explains the keys, states and columns."""

    DEFAULT_CSS = """
    HelpScreen Static { padding: 0 1; }
    """
    BINDINGS: ClassVar[list[BindingType]] = [
        Binding("escape,q,question_mark,f1", "app.pop_screen", "Back", key_display="Esc")
    ]

    def compose(self) -> ComposeResult:
        """Create the scrollable text."""
        with VerticalScroll():
            yield Static(_TEXT, markup=False)
        yield Footer()


_EVENTS = 200


class TopApp(App[None]):
    """Shows all channels of the machine; the caller closes the watch."""

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
        """Start to look."""
        self.push_screen(self._overview)
        self.call_later(self._look)
        self.set_interval(self._seconds, self._look)

    def on_overview_screen_chosen(self, message: OverviewScreen.Chosen) -> None:
        """Show a channel's message."""
        self.push_screen(MessageScreen(self._watch, message.channel, self._seconds))

    def action_help(self) -> None:
        """Show the help screen."""
        self.push_screen(HelpScreen())

    def action_pause(self) -> None:
        """Pause or resume the display."""
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
