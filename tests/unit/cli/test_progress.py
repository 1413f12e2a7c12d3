"""The line that says how long work stands."""

from __future__ import annotations

import io
import sys

import pytest

from rosplc.cli.text import ProgressLine


class Screen(io.StringIO):
    """A stream that is a terminal, or not."""

    def __init__(self, *, terminal: bool) -> None:
        super().__init__()
        self._terminal = terminal

    def isatty(self) -> bool:
        return self._terminal


def shown(monkeypatch: pytest.MonkeyPatch, *, terminal: bool, quiet: bool = False) -> str:
    """Return what two looks print, the second with a shorter text, when both are due."""
    screen = Screen(terminal=terminal)
    monkeypatch.setattr(sys, "stderr", screen)
    line = ProgressLine(quiet=quiet)
    line.show(lambda: "too early")
    for text in ("one and\x1b[31m", "two"):
        monkeypatch.setattr(line, "_next", 0.0)
        line.show(lambda text=text: text)
    line.clear()
    line.clear()
    return screen.getvalue()


def test_a_terminal_gets_one_line(monkeypatch: pytest.MonkeyPatch) -> None:
    """In a terminal the line is written over and removed; nothing in it acts upon the terminal."""
    output = shown(monkeypatch, terminal=True)
    assert "\n" not in output and "\x1b" not in output and output.split("\r")[-1] == ""
    assert [part.rstrip() for part in output.split("\r")] == ["", "one and\\x1b[31m", "two", "", ""]


def test_a_log_gets_lines(monkeypatch: pytest.MonkeyPatch) -> None:
    """Elsewhere each is a line of its own, and with --quiet there is none."""
    assert shown(monkeypatch, terminal=False) == "one and\\x1b[31m\ntwo\n"
    assert shown(monkeypatch, terminal=True, quiet=True) == ""
