"""The explanation of the backends says what the suite holds them to."""

from __future__ import annotations

from pathlib import Path

import pytest

from rosplc.ros import BACKENDS
from tests.conformance.backends.base import Abilities
from tests.conformance.backends.registry import HARNESSES

pytestmark = pytest.mark.verifies("backends", own="the same tests for all backends")

PAGE = Path(__file__).resolve().parents[2] / "docs" / "explanation" / "backends.md"


def table() -> str:
    """Return the harnesses' flags as the page shows them, one column per backend."""
    lines = [f"| | {' | '.join(f'`{name}`' for name in BACKENDS)} |", "| --- |" + " --- |" * len(BACKENDS)]
    for flag, words in Abilities.words().items():
        lines.append(f"| {words} | {' | '.join(cell(name, flag) for name in BACKENDS)} |")
    return "\n".join(lines)


def cell(backend: str, flag: str) -> str:
    """Return what a backend's harnesses say; there are several where it can be set up differently."""
    said = {getattr(harness.abilities, flag) for harness in HARNESSES if harness.backend == backend}
    return {frozenset({True}): "yes", frozenset({False}): "no"}.get(frozenset(said), "depends on the release")


def test_page_shows_the_flags_of_the_harnesses() -> None:
    """The page's table is the one that the harnesses give; it stands between its two marks."""
    text = PAGE.read_text(encoding="utf-8")
    begin, end = "<!-- abilities: begin -->\n", "\n<!-- abilities: end -->"
    assert text.partition(begin)[2].partition(end)[0] == table()


def test_every_backend_has_a_harness_and_a_row() -> None:
    """No backend is left out of the suite or of the page."""
    assert {harness.backend for harness in HARNESSES} == set(BACKENDS)
    text = PAGE.read_text(encoding="utf-8")
    assert all(f"| `{name}` |" in text for name in BACKENDS)
