"""Modbus TCP: libmodbus in C, pymodbus in Python."""

from __future__ import annotations

from rosplc.bench.arrangements import CYCLIC, ONE_CORE, ONE_CORE_CYCLE, TWO_CORES
from rosplc.bench.compiling import compile_program, find_library
from rosplc.bench.contenders.base import BLOCKS, CYCLE, Contender, Place, python_side, start_pair
from rosplc.bench.optional import need
from rosplc.bench.pair import Pair

__all__ = ["LIBMODBUS", "LIBMODBUS_FC23", "PYMODBUS"]

_BLOCKING = {TWO_CORES.name: BLOCKS, ONE_CORE.name: BLOCKS}
_CYCLES = {each.name: CYCLE for each in CYCLIC}


def _start_libmodbus(place: Place, requests: str) -> Pair:
    options = find_library("libmodbus", "libmodbus-dev")
    client = compile_program("modbus_client", place.cache, options=options)
    server = compile_program("modbus_server", place.cache, options=options)
    return start_pair(
        "libmodbus",
        place,
        a=[str(client), "A", requests],
        b=[str(server), "B"],
        order="BA",
        pass_on=True,
    )


def _start_pymodbus(place: Place) -> Pair:
    need("pymodbus")
    return start_pair(
        "pymodbus",
        place,
        a=python_side("modbus", "A"),
        b=python_side("modbus", "B"),
        order="BA",
        pass_on=True,
    )


LIBMODBUS = Contender(
    "libmodbus",
    "Modbus TCP, libmodbus (FC16, FC03)",
    "libmodbus client and server in C over the loopback interface, with the library's own settings (it sends "
    "at once, TCP_NODELAY); one request writes 100 registers, one reads 100",
    {**_BLOCKING, **_CYCLES, ONE_CORE_CYCLE.name: CYCLE},
    lambda place: _start_libmodbus(place, "separate"),
)
LIBMODBUS_FC23 = Contender(
    "libmodbus-fc23",
    "Modbus TCP, libmodbus (FC23)",
    "the same with the one request that writes 100 registers and reads 100 others",
    _BLOCKING,
    lambda place: _start_libmodbus(place, "combined"),
)
PYMODBUS = Contender(
    "pymodbus",
    "Modbus TCP, pymodbus",
    "pymodbus' synchronous client, which takes less time than its asynchronous one, and its server, with "
    "their own settings and no log; FC16 and FC03",
    {**_BLOCKING, **_CYCLES},
    _start_pymodbus,
)
