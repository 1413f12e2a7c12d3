"""The page of the fault campaign shows what the runs beside it gave."""

from __future__ import annotations

import json
import re
from pathlib import Path

ROOT = Path(__file__).resolve().parents[3]
PAGE = ROOT / "docs" / "explanation" / "fault-campaign.md"
IMAGES = ROOT / "docs" / "images" / "soak"


def test_each_figure_is_shown() -> None:
    """Every kind of cell that was run has a figure, and every figure that is there is shown."""
    runs = json.loads((IMAGES / "runs.json").read_text())
    kinds = {(run["backend"], run["plc"], tuple(run["spared"])) for run in runs}
    shown = re.findall(r"\]\(\.\./images/soak/(\S+\.svg)\)", PAGE.read_text())
    assert sorted(shown) == sorted(path.name for path in IMAGES.glob("*.svg"))
    assert len(shown) == len(kinds) + 1
