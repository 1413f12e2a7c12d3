"""Next(): no step of the delayed rule within a scan, and no time swallowed."""

from __future__ import annotations

import pytest

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


def test_time_before_next_counts_as_silence() -> None:
    """A peer that falls silent is found as soon where programs spend the scan before they call Next()."""
    spent = []
    for in_between in (0, 9):
        with Cell(cell_build(more={"Step": STEP})) as cell:
            writer = cell.channel("/in_order").writer(beat_ms=100)
            cell.until("/in_order", "xPeerAlive", True, beats=[writer])
            milliseconds = 0
            while cell.get("/in_order", "xPeerAlive"):
                cell.scan(step=10 - in_between)
                cell.machine.scan("Step", step=in_between)
                milliseconds += 10
                assert milliseconds < 2000
            spent.append(milliseconds)
    assert spent[0] == pytest.approx(spent[1], abs=20)
