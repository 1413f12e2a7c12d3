"""Text from others, before a terminal or a log sees it."""

from __future__ import annotations

import logging
import sys

__all__ = ["harmless", "log_to_stderr", "one_line"]


def harmless(text: str) -> str:
    """Return text with every character that a terminal would act upon written out."""
    # Names in an object come from whoever made it: no escape sequence may reach the terminal.
    return "".join(
        char if char.isprintable() or char == "\n" else char.encode("unicode_escape").decode()
        for char in text
    )


def one_line(text: str) -> str:
    """Return text made harmless, its line ends written out too."""
    return harmless(text).replace("\n", "\\n")


class _Formatter(logging.Formatter):
    """Keeps a message on its line: what others are called must not look like a line of the log."""

    def formatMessage(self, record: logging.LogRecord) -> str:
        return one_line(super().formatMessage(record))

    def format(self, record: logging.LogRecord) -> str:
        return harmless(super().format(record))  # a traceback has lines of its own


def log_to_stderr(level: int, text: str, *, times: str | None = None) -> None:
    """Log to stderr, unless the program has set up its log itself.

    Args:
        level: The lowest level that is logged.
        text: The form of a line, as :class:`logging.Formatter` takes it.
        times: The form of the time, if another than the usual.
    """
    handler = logging.StreamHandler(sys.stderr)
    handler.setFormatter(_Formatter(text, times))
    logging.basicConfig(level=level, handlers=[handler])
