"""The input of a generation: topics, tasks, and options for the whole project."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Literal

from rosplc.config.plans import ClassicPlan
from rosplc.errors import GenerationError
from rosplc.layout import Layout
from rosplc.shm.constants import MAX_BEAT_MS

LIBRARY = "SysSemProcess"
LONGEST_NAME = 80  # characters: SysShm and SysSemProcess take a STRING


def check_classic(topic: str, classic: ClassicPlan) -> None:
    """Raise GenerationError PLC007 if the memory or semaphore has an invalid name."""
    for name in (classic.name, classic.semaphore):
        plain = all("!" <= char <= "~" and char != "/" for char in name)
        if len(name) > LONGEST_NAME or not plain or not classic.name:
            raise GenerationError("PLC007", f"{name!r} is not a valid name", where=topic)


def classic_wait(classic: ClassicPlan, cycle_ns: int) -> int:
    """Return the ms to wait for the lock, at most half the task's cycle; ``cycle_ns`` 0 if it has none."""
    wait = -(-classic.wait_ns // 1_000_000)
    return min(wait, cycle_ns // 2_000_000) if cycle_ns else wait


@dataclass(frozen=True)
class PlcTopic:
    """A topic as seen by the PLC."""

    topic: str  # as ROS writes it
    layout: Layout  # its message's layout
    direction: Literal["read", "write"]  # ``"read"`` to the PLC, ``"write"`` to ROS
    task: str  # name of the task that serves it
    object_size: int = 0  # bytes of the shared-memory object; 0: the block asks the object
    stale_after_ns: int = 0  # age from which a message is stale; 0: never
    on_stale: Literal["hold", "zero", "value"] = "hold"  # what the message becomes then
    # with ``on_stale="value"``: the fields of that message, as a constant of the project; None:
    # what a program puts into ``stSafe``
    safe: Mapping[str, Any] | None = None
    in_order: bool = False  # take every message, not only the newest
    latched: bool = False  # take the state found at the start as a new message
    # a topic of the bridge's own, which has its own blocks: the log of the PLC's program (``rosout.plc``), a
    # transform's pose, ROS time
    own: Literal["", "log", "pose", "time"] = ""
    max_age_ns: int = 0  # of a pose: age from which it is not valid; 0: never
    # set for a topic in classic mode, without ``object_size`` and ``in_order``
    classic: ClassicPlan | None = None


@dataclass(frozen=True)
class PlcTask:
    """A task of the configuration; times in nanoseconds, 0: none."""

    name: str
    interval_ns: int = 10_000_000
    priority: int = 4
    kind: Literal["cyclic", "freewheeling"] = "cyclic"
    watchdog_ns: int = 0
    watchdog_sensitivity: int = 1


@dataclass(frozen=True)
class ProjectOptions:
    """Options for the whole project."""

    folder: str = "ROS"  # the top folder in the PLC project
    prefix: str = "rosplc"  # the prefix of shared-memory names
    target: Literal["x86", "arm"] = "x86"  # the PLC's processor, ``"x86"`` or ``"arm"``
    # whether the target orders memory accesses by a fence: on x86 it does, on ARM only where the
    # device description enables the MemoryBarrier library; where the project lacks the library the
    # blocks follow the delayed rule nevertheless
    fenced: bool = True
    # the least that a task promises as the longest time between two beats; see :func:`beat_ms`
    beat_ms: int = 0
    programs: str = "SharedMemory"  # what the names of the generated programs begin with
    pins: bool = False  # give blocks a pin for each top-level field


def target_of(machine: str) -> Literal["x86", "arm"]:
    """Return the target for :func:`platform.machine`: ARM unless x86, because its rule is safe everywhere."""
    return "x86" if machine.lower() in ("x86", "x86_64", "amd64", "i386", "i486", "i586", "i686") else "arm"


UNKNOWN_BEAT_MS = 1000  # promised where it is unknown how often a block is called
_SCANS, _LEAST_BEAT_MS = 10, 250


def beat_ms(task: PlcTask) -> int:
    """Return the longest time between two heartbeats that the blocks of a task promise, in ms.

    It is ten cycles, since a task may be late or pause; a dead writer's claim lasts three such times.
    """
    if task.kind != "cyclic":
        return UNKNOWN_BEAT_MS
    return min(max(_LEAST_BEAT_MS, -(-task.interval_ns * _SCANS // 1_000_000)), MAX_BEAT_MS)
