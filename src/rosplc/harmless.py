"""Text out of shared memory, before a terminal sees it."""

from __future__ import annotations

__all__ = ["harmless", "one_line"]


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
