"""The pages docs/reference/plc-blocks.md and plc-calls.md cannot drift from the blocks."""

from __future__ import annotations

from pathlib import Path

import pytest

from rosplc.plc.base import base_objects, call_objects, classic_objects
from rosplc.plc.project import Pou

ROOT = Path(__file__).resolve().parents[3]
TOOL = ROOT / "tools" / "generate_plc_reference.py"
REFERENCE = ROOT / "docs" / "reference"
PAGES = {
    "plc-blocks.md": (*base_objects("ROS/Base"), *classic_objects("ROS/Base")),
    "plc-calls.md": call_objects("ROS/Base", actions=True),
}
INNER = ("RosPlc_CallReader", "RosPlc_CallWriter")
"""Blocks inside the blocks of services and actions."""


@pytest.mark.parametrize("page", PAGES)
def test_every_input_and_output_of_the_base_is_listed_with_a_meaning(page):
    """A variable without a word on what it means would be of no use; second halves of pairs excepted."""
    text = (REFERENCE / page).read_text(encoding="utf-8")
    for item in PAGES[page]:
        if not isinstance(item, Pou) or item.kind != "FUNCTION_BLOCK" or item.name in INNER:
            continue
        for block in item.blocks:
            if block.kind in ("VAR_INPUT", "VAR_OUTPUT"):
                for variable in block.variables:
                    assert f"| `{variable.name}` |" in text
                    assert variable.comment or variable.name.endswith("Hi"), variable.name
