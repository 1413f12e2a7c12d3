"""The course of one number: the last values as a line of bars, with figures beside it."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable

from rich.text import Text
from textual.app import ComposeResult
from textual.containers import Vertical
from textual.widgets import Sparkline, Static

from rosplc.harmless import one_line

__all__ = ["Course", "History"]

_LOOKS = 600
_FIELDS = 2000


class History:
    """The last values of every number of a message, one per look."""

    def __init__(self) -> None:
        self._values: dict[str, deque[float]] = {}

    def note(self, numbers: Iterable[tuple[str, float]]) -> None:
        """Add what a look saw; what is over a limit of 2000 numbers is left out."""
        for path, number in numbers:
            known = self._values.get(path)
            if known is None:
                if len(self._values) >= _FIELDS:
                    continue
                known = self._values[path] = deque(maxlen=_LOOKS)
            known.append(number)

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
        """Show a number's course.

        Args:
            path: Its path.
            values: One per look, the oldest first; none if it is no number.
            seconds: Time between two looks.
        """
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
        # Bars stand on the lowest value: a steady number is a flat line, whatever its size.
        bars.data = [value - low for value in shown] if high > low else [0.0] * len(shown)
