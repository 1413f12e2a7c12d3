"""Contenders in Python besides Modbus: rosplc's channel, the source's design, OPC UA, iceoryx2."""

from __future__ import annotations

import secrets
from pathlib import Path

from rosplc.bench.arrangements import CYCLIC, ONE_CORE, TWO_CORES, Way
from rosplc.bench.contenders.base import (
    BLOCKS,
    CYCLE,
    RINGS,
    SPINS,
    Contender,
    Place,
    python_side,
    start_pair,
)
from rosplc.bench.optional import need
from rosplc.bench.pair import Pair
from rosplc.bench.scratch import NAMES_FILE

__all__ = ["ASYNCUA", "ICEORYX", "ICEORYX_BLACKBOARD", "ROSPLC_PYTHON", "ROSPLC_TYPED", "SEMAPHORE_PYTHON"]

_CYCLES = {each.name: CYCLE for each in CYCLIC}


def _start_rosplc(place: Place, module: str) -> Pair:
    tail = (place.folder, *place.names)
    return start_pair(
        "rosplc in Python", place, a=python_side(module, "A", *tail), b=python_side(module, "B", *tail)
    )


def _start_semaphore(place: Place) -> Pair:
    need("posix_ipc")
    tail = (place.folder / "areas", *place.names)
    return start_pair(
        "posix_ipc",
        place,
        a=python_side("semaphore", "A", *tail),
        b=python_side("semaphore", "B", *tail),
    )


def _start_opcua(place: Place) -> Pair:
    need("asyncua")
    return start_pair(
        "asyncua", place, a=python_side("opcua", "A"), b=python_side("opcua", "B"), order="BA", pass_on=True
    )


def _start_iceoryx(place: Place, kind: str) -> Pair:
    need("iceoryx2")
    # Its objects in /dev/shm lie in no folder: they begin with this unique name instead. It is short, for
    # its listeners are sockets in the file system, whose paths have 107 characters at most.
    prefix = f"rb{secrets.token_hex(4)}_"
    (place.folder / NAMES_FILE).write_text(prefix)
    a, b = (python_side("iceoryx", side, place.folder, prefix, kind) for side in "AB")
    try:
        pair = start_pair("iceoryx2", place, a=a, b=b)
    except BaseException:
        _remove_files(prefix)
        raise
    pair.on_release(lambda: _remove_files(prefix))
    return pair


def _remove_files(prefix: str) -> None:
    for path in Path("/dev/shm").glob(f"{prefix}*"):
        path.unlink(missing_ok=True)


ROSPLC_PYTHON = Contender(
    "rosplc-python",
    "rosplc channel, Python",
    "rosplc.shm: Writer.publish and Reader.update with records of bytes, in the C extension; the bell of "
    "the blocking arrangement is a POSIX semaphore (posix_ipc) beside the channel",
    {TWO_CORES.name: SPINS, ONE_CORE.name: RINGS, **_CYCLES},
    lambda place: _start_rosplc(place, "channel"),
    {ONE_CORE.name: "posix_ipc"},
)
ROSPLC_TYPED = Contender(
    "rosplc-python-typed",
    "rosplc channel, Python, typed messages",
    "the same, but B attaches with rosplc.attach and reads and writes messages with fields, lists of Python "
    "integers, as scripts do",
    {TWO_CORES.name: SPINS, **_CYCLES},
    lambda place: _start_rosplc(place, "typed_channel"),
)
SEMAPHORE_PYTHON = Contender(
    "semaphore-python",
    "source's design, Python (posix_ipc)",
    "the source's design with posix_ipc: lock, copy, compare, look again",
    {TWO_CORES.name: Way("spin", "spins (lock, copy, compare)"), **_CYCLES},
    _start_semaphore,
)
ASYNCUA = Contender(
    "asyncua",
    "OPC UA, asyncua",
    "asyncua's client writes one node and reads another, each an array and one request of a session that "
    "stays; its server adds one in the callback behind a write, which spares a subscription; without "
    "security and without a log",
    {TWO_CORES.name: BLOCKS, ONE_CORE.name: BLOCKS, **_CYCLES},
    _start_opcua,
)
ICEORYX = Contender(
    "iceoryx2",
    "iceoryx2, Python, publish and subscribe",
    "iceoryx2's Python package: a loaned sample, filled in place; to sleep, its events; its own settings but "
    "for the names of its files",
    {TWO_CORES.name: SPINS, ONE_CORE.name: Way("block", "sleeps on an iceoryx2 event"), **_CYCLES},
    lambda place: _start_iceoryx(place, "bytes"),
)
ICEORYX_BLACKBOARD = Contender(
    "iceoryx2-blackboard",
    "iceoryx2, Python, blackboard",
    "iceoryx2's Python package: an entry of its blackboard for each direction; to sleep, its events; its own "
    "settings but for the names of its files",
    {TWO_CORES.name: SPINS, ONE_CORE.name: Way("block", "sleeps on an iceoryx2 event"), **_CYCLES},
    lambda place: _start_iceoryx(place, "blackboard"),
)
