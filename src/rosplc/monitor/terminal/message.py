"""One channel: how it stands, its newest message as a tree, and the course of one number."""

from __future__ import annotations

import time
from contextlib import suppress
from datetime import datetime
from typing import TYPE_CHECKING, ClassVar

from rich.text import Text
from textual.app import ComposeResult
from textual.binding import Binding, BindingType
from textual.css.query import NoMatches
from textual.screen import Screen
from textual.widgets import Footer, Static, Tree

from rosplc.errors import ChannelError
from rosplc.harmless import one_line
from rosplc.levels import Level
from rosplc.monitor.cells import age_text, count_text, plc_text, rate_text, way_text
from rosplc.monitor.message import Message, numbers
from rosplc.monitor.picture import ChannelView, Picture
from rosplc.monitor.terminal.plot import Course, History
from rosplc.monitor.terminal.style import LEVEL_STYLES, plain, state_cell
from rosplc.monitor.terminal.values import ELEMENTS, ValueTree

if TYPE_CHECKING:
    from rosplc.monitor.watch import Watch

__all__ = ["MessageScreen"]

_SHARE = 10


class MessageScreen(Screen[None]):
    """Shows one channel until it is left.

    Args:
        watch: Where messages come from; the application looks, this screen asks for messages.
        channel: The channel as it stood when it was chosen.
        seconds: Time between two looks.
    """

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
        self._watch = watch
        self._channel = channel
        self._seconds = seconds
        self._history = History()
        self._path = ""
        self._shape: object = None
        self._next = 0.0

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
        if time.monotonic() >= self._next:
            self._take()

    def _head(self) -> None:
        view = self._channel
        self.query_one("#channel-head", Static).update(
            Text.assemble((one_line(view.topic), "bold"), f"  {way_text(view)}  ", one_line(view.type_name)),
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
        began = time.thread_time()
        try:
            message = self._watch.message(self._channel, ELEMENTS)
        except ChannelError as error:
            self._say(f"{error.what} [{error.code}]; these are the last values")
            return
        finally:
            # A large message takes its time: no more than a tenth of it is spent on decoding.
            self._next = time.monotonic() + _SHARE * (time.thread_time() - began)
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
