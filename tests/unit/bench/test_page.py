"""The documentation's page of results is what the report beside it gives."""

from __future__ import annotations

import json
import re
from pathlib import Path

ROOT = Path(__file__).resolve().parents[3]
PAGE = ROOT / "docs" / "explanation" / "comparison.md"
IMAGES = ROOT / "docs" / "images" / "bench"


def test_the_page_shows_every_section_with_figures_that_exist() -> None:
    """The report has every section and no failure, and each image of the page is there."""
    report = json.loads((IMAGES / "report.json").read_text())
    assert len(report["sections"]) == 5
    assert not any(section["failures"] for section in report["sections"])
    shown = set(re.findall(r"\]\(\.\./images/bench/(\S+\.svg)\)", PAGE.read_text()))
    assert shown == {path.name for path in IMAGES.glob("*.svg")} != set()
