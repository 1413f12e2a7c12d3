"""One channel: its state, its newest message as a tree, and the course of one number."""

from __future__ import annotations

import math
from collections import defaultdict, deque
from collections.abc import Iterable
from contextlib import suppress
from datetime import datetime
from typing import TYPE_CHECKING, Any, ClassVar

from rich.text import Text
from textual.app import ComposeResult
from textual.binding import Binding, BindingType
from textual.containers import Vertical
from textual.css.query import NoMatches
from textual.screen import Screen
from textual.widgets import Footer, Sparkline, Static, Tree
from textual.widgets.tree import TreeNode

from rosplc.errors import ChannelError
from rosplc.harmless import one_line
from rosplc.layout.view import Excerpt
from rosplc.levels import Level
from rosplc.monitor.message import Message, numbers
from rosplc.monitor.picture import ChannelView, Picture, age_text, count_text, plc_text, rate_text, way_text
from rosplc.monitor.terminal.table import LEVEL_STYLES, plain, state_cell

if TYPE_CHECKING:
    from rosplc.monitor.watch import Watch

_LOOKS = 600
_FIELDS = 2000


class History:
    """The last values of every number of a message, one per look."""

    def __init__(self) -> None:
        self._values: defaultdict[str, deque[float]] = defaultdict(lambda: deque(maxlen=_LOOKS))

    def note(self, numbers: Iterable[tuple[str, float]]) -> None:
        """Add what a look saw; what is over a limit of 2000 numbers is left out."""
        for path, number in numbers:
            if path in self._values or len(self._values) < _FIELDS:
                self._values[path].append(number)

    def clear(self) -> None:
        """Forget everything: the type is another one."""
        self._values.clear()

    def first(self) -> str:
        """Return the first number that is no part of a header; empty if there is none."""
        names = [path for path in self._values if "header." not in path] or list(self._values)
        return names[0] if names else ""

    def of(self, path: str) -> list[float]:
        """Return a number's values, the oldest first; none if the path is no number's."""
        return list(self._values.get(path, ()))


class Course(Vertical):
    """Shows the course of one number."""

    DEFAULT_CSS = """
    Course { height: 4; }
    Course Sparkline { height: 2; width: 1fr; }
    Course Static { height: 1; }
    """

    def compose(self) -> ComposeResult:
        """Make heading, bars and figures."""
        yield Static("", id="course-name")
        yield Sparkline([], id="course-bars")
        yield Static("", id="course-figures")

    def show(self, path: str, values: list[float], seconds: float) -> None:
        """Show a number's course: its values, one per look, the oldest first (none if it is no number)."""
        name = self.query_one("#course-name", Static)
        bars = self.query_one("#course-bars", Sparkline)
        figures = self.query_one("#course-figures", Static)
        shown = values[-max(1, self.size.width) :]
        if not shown:
            name.update(Text("There is no number in it", style="dim"))
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
_TEXT = 300


class ValueTree(Tree[str]):
    """Shows nested values; a node's data is its path, ``pose.position.x`` or ``ranges[3]``.

    Labels change in place, so that what is open stays open and the cursor stays where it is.
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
        """Show a message's values; where ``shape`` differs from the last one, the tree is built again."""
        if shape != self._shape:
            self._shape = shape
            self.clear()
            self.root.expand()
            self._known = {"": self.root}
            self._labels.clear()
        self._items = {"": values}
        self._update(self.root, "", values)

    def on_tree_node_expanded(self, event: Tree.NodeExpanded[str]) -> None:
        """Fill what was opened."""
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
        return one_line(repr(value if len(value) <= _TEXT else value[:_TEXT] + "…"))
    return str(value)


_SHARE = 10


class MessageScreen(Screen[None]):
    """Shows one channel until it is left; ``seconds`` lie between two looks."""

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
        self._history = History()
        self._path = ""
        self._shape: object = None
        self._next = 0

    def compose(self) -> ComposeResult:
        """Make heading, tree, course and keys."""
        yield Static(id="channel-head")
        yield Static(id="channel-state")
        yield Static(id="channel-words")
        yield Static(id="channel-message")
        yield ValueTree()
        yield Course()
        yield Footer()

    def on_mount(self) -> None:
        """Show what is known already."""
        self.query_one(ValueTree).focus()
        self._head()
        self._take()

    def on_tree_node_highlighted(self, event: Tree.NodeHighlighted[str]) -> None:
        """Show the course of the number under the cursor."""
        if self._history.of(event.node.data or ""):
            self._path = event.node.data or ""
            with suppress(NoMatches):  # the screen goes
                self._draw_course()

    def show(self, picture: Picture) -> None:
        """Show a new look."""
        found = picture.channel(self._channel.id)
        if found is None:
            self.query_one("#channel-state", Static).update(Text("X gone", style=LEVEL_STYLES[Level.ERROR]))
            self._say("the channel is gone; these are its last values")
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
        self._history.note(numbers(message.values))
        if not self._history.of(self._path):
            self._path = self._history.first()
        self.query_one(ValueTree).show(message.values, shape)
        self.query_one("#channel-message", Static).update(plain(_about(message), "dim"), layout=False)
        self._draw_course()

    def _draw_course(self) -> None:
        self.query_one(Course).show(self._path, self._history.of(self._path), self._seconds)

    def _say(self, words: str) -> None:
        self.query_one("#channel-words", Static).update(plain(words), layout=False)


def _about(message: Message) -> str:
    words = [f"message {message.sequence}"] if message.sequence else []
    if message.clock == "system":
        stamp = datetime.fromtimestamp(message.stamp_ns % (1 << 62) / 1e9)
        words.append(f"stamped {stamp:%H:%M:%S.%f}"[:-3])
    elif message.clock:
        words.append(f"stamped {message.stamp_ns / 1e9:.3f} s by the {message.clock} clock")
    return "  ".join([*words, *message.marks])
