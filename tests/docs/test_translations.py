"""A translated page follows its source paragraph by paragraph; each has its source's hash above it."""

from __future__ import annotations

import hashlib
import re
from pathlib import Path

import pytest

from links import relative_links

ROOT = Path(__file__).resolve().parents[2]
MARK = re.compile(r"<!-- source: ([0-9a-f]{8}) -->\n")
TRANSLATIONS = {
    "README.de.md": "README.md",
    "docs/tutorial/codesys.de.md": "docs/tutorial/codesys.md",
}
"""Translated page → its source."""


def paragraphs(text: str) -> list[str]:
    """Return the parts between blank lines; a fenced block with the comments above it is one."""
    found: list[list[str]] = [[]]
    fenced = False
    for line in text.splitlines():
        fenced ^= line.startswith("```")
        if line.strip() or fenced:
            found[-1].append(line)
        else:
            found.append([])
    return ["\n".join(lines) for lines in found if lines]


def out_of_date(translation: str, source: str) -> list[str]:
    """Return the paragraphs of the source that the translation does not follow, with their hashes."""
    marks = MARK.findall(translation)
    wanted = [(hashlib.sha256(part.encode()).hexdigest()[:8], part) for part in paragraphs(source)]
    missing = [f"{mark}: {part.splitlines()[0]}" for mark, part in wanted if mark not in marks]
    return missing or [mark for mark in marks if mark not in dict(wanted)]


@pytest.mark.parametrize("page", TRANSLATIONS)
def test_a_translation_is_of_the_present_source(page: str) -> None:
    """Every paragraph of the source has its translation, in order; commands are the same."""
    translation = (ROOT / page).read_text(encoding="utf-8")
    source = (ROOT / TRANSLATIONS[page]).read_text(encoding="utf-8")
    assert out_of_date(translation, source) == []
    own = [MARK.sub("", part) for part in paragraphs(translation)]
    assert len(own) == len(paragraphs(source)) == len(MARK.findall(translation))
    assert [part for part in own if "```" in part] == [part for part in paragraphs(source) if "```" in part]


@pytest.mark.parametrize("page", TRANSLATIONS)
def test_links_of_a_translation_are_those_of_its_source(page: str) -> None:
    """It leads to the same pages; the two name each other."""
    own = relative_links((ROOT / page).read_text(encoding="utf-8"))
    theirs = relative_links((ROOT / TRANSLATIONS[page]).read_text(encoding="utf-8"))
    here, there = Path(page).name, Path(TRANSLATIONS[page]).name
    assert [link for link in own if link != there] == [link for link in theirs if link != here]
    assert there in own
    assert here in theirs


def test_a_changed_paragraph_is_noticed() -> None:
    """One word more, or a paragraph that is gone, is a difference."""
    part = "one two"
    translation = f"<!-- source: {hashlib.sha256(part.encode()).hexdigest()[:8]} -->\neins zwei\n"
    assert out_of_date(translation, part) == []
    assert out_of_date(translation, "one two three")
    assert out_of_date(translation, f"{part}\n\nthree")
    assert out_of_date(translation + "\n<!-- source: 00000000 -->\ndrei\n", part)
