"""Relative links in Markdown pages: where they stand, and which anchors a page's headings give."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path

_LINK = re.compile(r"!?\[[^\]]*\]\((?P<inline>[^)\s]+)\)|<img [^>]*src=\"(?P<image>[^\"]+)\"")
_FENCED = re.compile(r"^(?P<fence> *`{3,}).*?^(?P=fence)$", re.MULTILINE | re.DOTALL)
_CODE = re.compile(rf"{_FENCED.pattern}|`[^`\n]*`", re.MULTILINE | re.DOTALL)


def rewrite(text: str, change: Callable[[str], str]) -> str:
    """Return a page's text with every relative link as ``change`` gives it; code is left alone."""
    # Code may stand in a link's own text, so it is blotted out and not cut out.
    blotted = _CODE.sub(lambda code: "." * len(code[0]), text)
    parts, end = [], 0
    for match in _LINK.finditer(blotted):
        kind = "inline" if match["inline"] else "image"
        if not re.match("[a-z]+:", match[kind]):
            first, last = match.span(kind)
            parts += [text[end:first], change(text[first:last])]
            end = last
    return "".join([*parts, text[end:]])


def relative_links(text: str) -> list[str]:
    """Return a page's relative links, anchors included, in order."""
    found: list[str] = []

    def noted(link: str) -> str:
        found.append(link)
        return link

    rewrite(text, noted)
    return found


def anchors(path: Path) -> set[str]:
    """Return the anchors of a page's headings, as GitHub and the site form them."""
    text = _FENCED.sub("", path.read_text(encoding="utf-8"))
    headings = re.findall(r"^#{1,6} (.+)$", text, re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", heading.strip().lower()).replace(" ", "-") for heading in headings}
