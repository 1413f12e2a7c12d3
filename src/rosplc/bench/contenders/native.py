"""Contenders in C: rosplc's channel, the source's design, a bare exchange."""

from __future__ import annotations

from rosplc.bench.arrangements import (
    CYCLIC,
    ONE_CORE,
    ONE_CORE_BUSY,
    ONE_CORE_CYCLE,
    ONE_CORE_YIELD,
    TWO_CORES,
    TWO_CORES_BLOCKING,
    Way,
)
from rosplc.bench.compiling import compile_program
from rosplc.bench.contenders.base import CYCLE, RINGS, SPINS, Contender, Place, start_pair
from rosplc.bench.contenders.registers import ANSWER, QUESTION, describe, layout
from rosplc.bench.pair import Pair
from rosplc.shm import Direction, Namespace, OwnedChannel

__all__ = ["BARE", "ROSPLC_C", "SEMAPHORE_C", "SIGNAL_C", "objects"]

_CYCLES = {each.name: CYCLE for each in CYCLIC}
_BUSY = {
    ONE_CORE_BUSY.name: SPINS,
    ONE_CORE_YIELD.name: Way("yield", "looks again when it gets the core back (sched_yield)"),
    ONE_CORE_CYCLE.name: CYCLE,
}


def objects(place: Place) -> tuple[str, str]:
    """Make an object for each direction; return the paths of the one towards B and the one towards A."""
    namespace = Namespace("rosplc", place.folder)
    paths = []
    for topic, direction in ((QUESTION, Direction.TO_PLC), (ANSWER, Direction.TO_ROS)):
        with OwnedChannel.open(namespace, describe(topic, direction), record_size=layout().size) as channel:
            paths.append(str(channel.path))
    return paths[0], paths[1]


def _start_rosplc(place: Place) -> Pair:
    program = str(compile_program("rosplc_peer", place.cache))
    tail = [*objects(place), *place.names]
    return start_pair("rosplc in C", place, a=[program, "A", *tail], b=[program, "B", *tail])


def _start_bare(place: Place) -> Pair:
    program, file = str(compile_program("bare", place.cache)), str(place.folder / "boxes")
    return start_pair("bare exchange", place, a=[program, "A", file], b=[program, "B", file])


def _start_semaphore(place: Place, *more: str) -> Pair:
    program, file = str(compile_program("semaphore", place.cache)), str(place.folder / "areas")
    tail = [file, *place.names, *more]
    return start_pair("shared memory and semaphore", place, a=[program, "A", *tail], b=[program, "B", *tail])


BARE = Contender(
    "bare",
    "bare flag and copy, C",
    "a flag in a cache line of its own and a copy of the same 200 bytes: the physical limit, without any "
    "protection",
    {TWO_CORES.name: SPINS},
    _start_bare,
)
ROSPLC_C = Contender(
    "rosplc-c",
    "rosplc channel, C",
    "the C core's own headers: claims, fences, sequence checks and both liveness words as in every program "
    "that uses them; the bell of the blocking arrangement is a POSIX semaphore beside the channel, which "
    "itself has none",
    {
        TWO_CORES.name: SPINS,
        ONE_CORE.name: RINGS,
        TWO_CORES_BLOCKING.name: RINGS,
        **_BUSY,
        **_CYCLES,
    },
    _start_rosplc,
)
SEMAPHORE_C = Contender(
    "semaphore-c",
    "source's design, C",
    "shared memory with a named semaphore as its lock; the reader takes the lock, copies, and looks again "
    "until the numbers differ, as the source's programs do",
    {
        TWO_CORES.name: Way("spin", "spins (lock, copy, compare)"),
        **_BUSY,
        **_CYCLES,
    },
    _start_semaphore,
)
SIGNAL_C = Contender(
    "signal-c",
    "semaphores as signals, C",
    "the source's parts put together otherwise: the writer posts the semaphore, the reader waits for it",
    dict.fromkeys((ONE_CORE.name, TWO_CORES_BLOCKING.name), Way("block", "sleeps on the semaphore")),
    lambda place: _start_semaphore(place, "signal"),
)
