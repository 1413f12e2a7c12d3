"""Text for people: made harmless for terminals and logs, numbers with units, names shortened."""

from __future__ import annotations

import difflib
import logging
import sys
from collections.abc import Iterable


def harmless(text: str) -> str:
    """Return text with every character that a terminal would act upon written out."""
    # Names in an object come from its maker: no escape sequence may reach the terminal.
    return "".join(
        char if char.isprintable() or char == "\n" else char.encode("unicode_escape").decode()
        for char in text
    )


def one_line(text: str) -> str:
    """Return text made harmless, its line ends written out too."""
    return harmless(text).replace("\n", "\\n")


def plural(count: int, noun: str) -> str:
    """Return a number with its noun: 1 topic, 2 topics, 3 libraries."""
    if count == 1:
        return f"1 {noun}"
    return f"{count} {noun[:-1]}ies" if noun.endswith("ry") else f"{count} {noun}s"


def shorten(text: str, width: int) -> str:
    """Return text of at most ``width`` characters, the middle of a longer one replaced by an ellipsis."""
    if len(text) <= width:
        return text
    head = (width - 1) // 3
    return f"{text[:head]}…{text[len(text) - (width - 1 - head) :]}"


def nearest(word: str, known: Iterable[str]) -> str:
    """Return the known name that was probably meant: another case, a slash, a namespace, a slip; or empty."""
    names = sorted(known)
    plain = {name.casefold().strip("/"): name for name in names}
    wanted = word.casefold().strip("/")
    below = [name for name in names if name.casefold().endswith("/" + wanted)]
    if wanted not in plain and len(below) == 1:
        return below[0]
    near = difflib.get_close_matches(wanted, plain, 1, cutoff=0.6)
    return plain[near[0]] if near else ""


def listed(items: Iterable[object], most: int = 4) -> str:
    """Return the first few of many things, and how many more there are."""
    texts = [str(item) for item in items]
    more = f" and {len(texts) - most} more" if len(texts) > most else ""
    return ", ".join(texts[:most]) + more


def in_bytes(count: int) -> str:
    """Return a number of bytes with a fitting unit, as people read it."""
    if count < 1024:
        return plural(count, "byte")
    return f"{count / 1024:.1f} KiB" if count < 1024**2 else f"{count / 1024**2:.1f} MiB"


class _Formatter(logging.Formatter):
    """Keeps a message on its line: what others are called must not look like a line of the log."""

    def formatMessage(self, record: logging.LogRecord) -> str:
        return one_line(super().formatMessage(record))

    def format(self, record: logging.LogRecord) -> str:
        return harmless(super().format(record))  # a traceback has lines of its own


def log_to_stderr(level: int) -> None:
    """Log to stderr with date and time, unless the program has set up its log itself.

    Args:
        level: The lowest level that is logged.
    """
    handler = logging.StreamHandler(sys.stderr)
    handler.setFormatter(_Formatter("%(asctime)s %(levelname)-7s %(message)s"))
    logging.basicConfig(level=level, handlers=[handler])
