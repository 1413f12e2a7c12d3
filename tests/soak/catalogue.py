"""Which kinds of fault a cell can have."""

from __future__ import annotations

from tests.soak.cell import Cell
from tests.soak.faults import FAULTS, HUB_FAULTS, Fault
from tests.soak.plc_faults import PLC_FAULTS

__all__ = ["faults_for"]


def faults_for(cell: Cell) -> tuple[Fault, ...]:
    """Return the faults that there are with a cell's backend and PLC."""
    return (
        *FAULTS,
        *(HUB_FAULTS if "hub" in cell.parts else ()),
        *(PLC_FAULTS if cell.plc == "st" else ()),
    )
