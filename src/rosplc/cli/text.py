"""Plain text that reads well in a terminal, a pipe and a log: aligned columns, no colours.

On a terminal, tables and sentences fit its width: sentences are wrapped between words, names are
shortened in the middle. In a pipe or a file each line is as long as its content.
"""

from __future__ import annotations

import json
import math
import shutil
import sys
import textwrap
import time
from collections.abc import Callable, Iterable, Sequence
from typing import Any

import typer

from rosplc.harmless import harmless, shorten

_GAP = 2
_LEAST = 12  # characters that a column of names or sentences keeps at least
_LEAST_WIDTH = 40
_TERMINAL_S, _LOG_S = 1.0, 10.0  # time between two lines of progress


def terminal_width() -> int | None:
    """Return the width that stdout has as a terminal; None for a pipe or a file."""
    if not sys.stdout.isatty():
        return None
    return max(_LEAST_WIDTH, shutil.get_terminal_size().columns)


def say(text: str = "") -> None:
    """Print text on stdout, made harmless and wrapped between words."""
    typer.echo(wrap(harmless(text), terminal_width()))


def warn(text: str) -> None:
    """Print text on stderr, made harmless and wrapped between words."""
    typer.echo(wrap(harmless(text), terminal_width() if sys.stderr.isatty() else None), err=True)


def wrap(text: str, width: int | None) -> str:
    """Return text with each line wrapped between words; continued lines are indented as their line is."""
    if width is None:
        return text
    lines: list[str] = []
    for line in text.split("\n"):
        indent = line[: len(line) - len(line.lstrip())]
        lines += _wrapped(line, width, indent) if len(line) > width else [line]
    return "\n".join(lines)


def _wrapped(text: str, width: int, indent: str = "") -> list[str]:
    return textwrap.wrap(
        text, width, subsequent_indent=indent, break_long_words=False, break_on_hyphens=False
    ) or [""]


def table(rows: Iterable[Sequence[object]], *, header: Sequence[str] = (), indent: int = 0) -> None:
    """Print rows as aligned columns that fit the terminal."""
    for line in columns(rows, header=header, indent=indent):
        typer.echo(harmless(line))


def columns(
    rows: Iterable[Sequence[object]], *, header: Sequence[str] = (), indent: int = 0, width: int | None = None
) -> list[str]:
    """Return rows as aligned lines; numbers are aligned to the right, the last column is not padded.

    ``header`` has a title for each column. A line has at most ``width`` characters after ``indent`` blanks;
    None takes the terminal's, and none in a pipe.
    """
    cells = [[str(cell) for cell in row] for row in rows]
    if not cells:
        return []
    numeric = [all(cell.replace(".", "", 1).isdigit() for cell in cut) for cut in zip(*cells, strict=True)]
    if header:
        cells.insert(0, list(header))
    natural = [max(len(row[column]) for row in cells) for column in range(len(cells[0]))]
    limit = width or terminal_width()
    widths = natural if limit is None else _fitted(cells, natural, numeric, limit - indent)
    lines = []
    for row in cells:
        folded = [_folded(cell, size) for cell, size in zip(row, widths, strict=True)]
        for number in range(max(map(len, folded))):
            parts = [column[number] if number < len(column) else "" for column in folded]
            padded = [
                part.rjust(size) if right else part.ljust(size)
                for part, size, right in zip(parts, widths, numeric, strict=True)
            ]
            lines.append((" " * indent + (" " * _GAP).join(padded)).rstrip())
    return lines


def _fitted(cells: list[list[str]], natural: list[int], numeric: list[bool], limit: int) -> list[int]:
    """Return the columns' widths, the widest narrowed until a line fits or nothing can be narrowed."""
    widths = list(natural)
    least = [size if right else min(size, _LEAST) for size, right in zip(natural, numeric, strict=True)]
    excess = sum(widths) + _GAP * (len(widths) - 1) - limit
    while excess > 0:
        column = max(range(len(widths)), key=lambda each: widths[each] - least[each])
        if widths[column] <= least[column]:
            break
        widths[column] -= 1
        excess -= 1
    return widths


def _folded(cell: str, width: int) -> list[str]:
    """Return a cell as lines of at most ``width``: sentences wrapped, names shortened in the middle."""
    if len(cell) <= width:
        return [cell]
    return [shorten(line, width) for line in _wrapped(cell, width)]


class ProgressLine:
    """Progress on stderr: a line that is rewritten in a terminal, printed now and then into a log."""

    def __init__(self, *, quiet: bool = False) -> None:
        self._quiet = quiet
        self._terminal = sys.stderr.isatty()
        self._period = _TERMINAL_S if self._terminal else _LOG_S
        self._next = time.monotonic() + self._period
        self._shown = 0

    def show(self, text: Callable[[], str]) -> None:
        """Show the present text, if it is time."""
        now = time.monotonic()
        if self._quiet or now < self._next:
            return
        self._next = now + self._period
        line = harmless(text())
        sys.stderr.write("\r" + line.ljust(self._shown) if self._terminal else line + "\n")
        sys.stderr.flush()
        self._shown = len(line) if self._terminal else 0

    def clear(self) -> None:
        """Remove the line, so that other output can follow."""
        if self._shown:
            sys.stderr.write("\r" + " " * self._shown + "\r")
            sys.stderr.flush()
            self._shown = 0


def print_json(value: Any, *, one_line: bool = False) -> None:
    """Print ``value`` as one JSON document on stdout; NaN and infinity become strings.

    It is ASCII: text out of shared memory may hold what a terminal would act upon, or bytes
    that are no UTF-8.
    """
    sys.stdout.write(json.dumps(finite(value), indent=None if one_line else 2) + "\n")
    if one_line:
        sys.stdout.flush()


def finite(value: Any) -> Any:
    """Return ``value`` as JSON can hold it: JSON has no NaN, and jq would refuse the document."""
    if isinstance(value, float) and not math.isfinite(value):
        return str(value)
    if isinstance(value, dict):
        return {key: finite(item) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [finite(item) for item in value]
    return list(value) if isinstance(value, (bytes, bytearray)) else value
