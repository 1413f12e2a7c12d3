"""docs/reference/plc-blocks.md cannot drift from the blocks."""

from __future__ import annotations

from pathlib import Path

from rosplc.plc.base import base_objects, classic_objects
from rosplc.plc.project import Pou

ROOT = Path(__file__).resolve().parents[3]
TOOL = ROOT / "tools" / "generate_plc_reference.py"
PAGE = ROOT / "docs" / "reference" / "plc-blocks.md"


def test_every_input_and_output_of_the_base_is_listed_with_a_meaning():
    """A variable without a word on what it means would be of no use; second halves of pairs excepted."""
    text = PAGE.read_text(encoding="utf-8")
    for item in (*base_objects("ROS/Base"), *classic_objects("ROS/Base")):
        if not isinstance(item, Pou) or item.kind != "FUNCTION_BLOCK":
            continue
        for block in item.blocks:
            if block.kind in ("VAR_INPUT", "VAR_OUTPUT"):
                for variable in block.variables:
                    assert f"| `{variable.name}` |" in text
                    assert variable.comment or variable.name.endswith("Hi"), variable.name
