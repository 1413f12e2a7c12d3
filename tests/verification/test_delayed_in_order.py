"""Next() under the delayed rule: the end of a scan stands for a fence, so a scan may not do two steps."""

from __future__ import annotations

import shutil

import pytest

pytest.importorskip("blark")
if shutil.which("gcc") is None:
    pytest.skip("Debian package gcc is missing", allow_module_level=True)

from tests.verification.plc_cell import Cell, cell_build, pattern

STEP = """PROGRAM Step
VAR
    xFound : BOOL;
END_VAR
xFound := ROS_Read.in_order.Next();
END_PROGRAM
"""


def test_next_neither_chooses_nor_copies_nor_proves() -> None:
    """However often a program calls Next(), a message takes its scans, and each comes once."""
    with Cell(cell_build(more={"Step": STEP})) as cell:
        cell.machine.set("RosPlc_Settings.xFenced", False)
        writer = cell.channel("/in_order", slots=16).writer()
        cell.until("/in_order", "xAttached", True)
        for number in range(1, 9):
            writer.publish(pattern(number))
        taken = []
        for _ in range(30):
            cell.scan(beats=[writer])
            if cell.get("/in_order", "xNew"):
                taken.append(cell.get("/in_order", "udiSequence"))
                assert cell.record("/in_order") == pattern(taken[-1])
            before = cell.get("/in_order", "xPending", "xChosen", "udiSequence")
            for _ in range(3):
                cell.machine.scan("Step", step=0)
                assert cell.machine.get("Step.xFound") is False
            assert cell.get("/in_order", "xPending", "xChosen", "udiSequence") == before
        assert taken == list(range(1, 9))
        assert cell.get("/in_order", "udiLost") == 0
