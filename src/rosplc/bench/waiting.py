"""How much of the source's own figures was waiting: its design on one core, waiting in several ways."""

from __future__ import annotations

from typing import Any

from rosplc.bench.arrangements import TWO_CORES, WAITING
from rosplc.bench.contenders.modbus import LIBMODBUS
from rosplc.bench.contenders.native import ROSPLC_C, SEMAPHORE_C, SIGNAL_C
from rosplc.bench.context import Context
from rosplc.bench.section import Section
from rosplc.bench.turns import take_turns
from rosplc.bench.waiting_page import page

__all__ = ["WAITING_SECTION"]

_CONTENDERS = (SEMAPHORE_C, SIGNAL_C, ROSPLC_C, LIBMODBUS)


def _run(context: Context) -> dict[str, Any]:
    return {"arrangements": take_turns(context, _CONTENDERS, (*WAITING, TWO_CORES))}


WAITING_SECTION = Section(
    "waiting",
    "How much of the source's figures was waiting",
    "The source's board has one core. Here its design runs on one core of this machine, and only the way to "
    "wait changes; what two cores take that never wait for a core shows what the exchange itself costs.",
    _run,
    page,
    tuple(contender.name for contender in _CONTENDERS),
)
