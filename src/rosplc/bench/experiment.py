"""The source's experiment: 100 numbers there and back, by every contender that this machine has."""

from __future__ import annotations

from typing import Any

from rosplc.bench.arrangements import ARRANGEMENTS
from rosplc.bench.contenders import CONTENDERS
from rosplc.bench.context import Context
from rosplc.bench.experiment_page import page
from rosplc.bench.machine import load_average
from rosplc.bench.section import Section
from rosplc.bench.turns import CYCLES, take_turns

__all__ = ["EXPERIMENT"]


def _run(context: Context) -> dict[str, Any]:
    before = load_average()[0]
    arrangements = take_turns(context, CONTENDERS, ARRANGEMENTS)
    load = [before, load_average()[0]]
    return {"cycles": list(CYCLES), "load": load, "arrangements": arrangements}


EXPERIMENT = Section(
    "experiment",
    "The source's experiment",
    "Two processes exchange 100 unsigned integers of 16 bits: A writes 100, B reads them, adds one to each "
    "and writes 100 back, A reads and adds one; for 10 to 1000 cycles. The final values prove that nothing "
    "was torn, lost or repeated.",
    _run,
    page,
    tuple(contender.name for contender in CONTENDERS),
)
