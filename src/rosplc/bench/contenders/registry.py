"""Every contender, in the order of tables."""

from __future__ import annotations

from rosplc.bench.contenders.base import Contender
from rosplc.bench.contenders.modbus import LIBMODBUS, LIBMODBUS_FC23, PYMODBUS
from rosplc.bench.contenders.native import BARE, ROSPLC_C, SEMAPHORE_C, SIGNAL_C
from rosplc.bench.contenders.python import (
    ASYNCUA,
    ICEORYX,
    ICEORYX_BLACKBOARD,
    ROSPLC_PYTHON,
    ROSPLC_TYPED,
    SEMAPHORE_PYTHON,
)
from rosplc.bench.contenders.structured_text import ROSPLC_ST

__all__ = ["CONTENDERS"]

CONTENDERS: tuple[Contender, ...] = (
    BARE,
    ROSPLC_C,
    ROSPLC_ST,
    ROSPLC_PYTHON,
    ROSPLC_TYPED,
    SEMAPHORE_C,
    SIGNAL_C,
    SEMAPHORE_PYTHON,
    ICEORYX,
    ICEORYX_BLACKBOARD,
    LIBMODBUS,
    LIBMODBUS_FC23,
    PYMODBUS,
    ASYNCUA,
)
