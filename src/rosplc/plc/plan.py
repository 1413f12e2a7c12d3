"""What a generation is asked for: topics, tasks, and what holds for the whole project."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Literal

from rosplc.layout import Layout
from rosplc.plc.classic import Classic

__all__ = ["PlcTask", "PlcTopic", "ProjectOptions"]


@dataclass(frozen=True)
class PlcTopic:
    """One topic as the PLC sees it.

    Attributes:
        topic: As ROS writes it.
        layout: Its message's layout.
        direction: ``"read"`` towards the PLC, ``"write"`` towards ROS.
        task: Name of the task that serves it.
        object_size: Bytes of the shared-memory object; 0: the block asks the object.
        stale_after_ns: Age from which a message is stale; 0: never.
        on_stale: What the message becomes then.
        safe: With ``on_stale="value"``: the fields of that message, as a constant of the project; None: what
            a program puts into ``stSafe``.
        in_order: Take every message, not only the newest.
        latched: Take the state found at the start as a new message.
        classic: Set for a topic in classic mode; ``object_size`` and ``in_order`` then have no meaning.
    """

    topic: str
    layout: Layout
    direction: Literal["read", "write"]
    task: str
    object_size: int = 0
    stale_after_ns: int = 0
    on_stale: Literal["hold", "zero", "value"] = "hold"
    safe: Mapping[str, Any] | None = None
    in_order: bool = False
    latched: bool = False
    classic: Classic | None = None


@dataclass(frozen=True)
class PlcTask:
    """One task of the configuration; times in nanoseconds, 0: none."""

    name: str
    interval_ns: int = 10_000_000
    priority: int = 4
    kind: Literal["cyclic", "freewheeling"] = "cyclic"
    watchdog_ns: int = 0
    watchdog_sensitivity: int = 1


@dataclass(frozen=True)
class ProjectOptions:
    """What holds for the whole project.

    Attributes:
        folder: The top folder in the PLC project.
        prefix: The prefix of shared-memory names.
        fenced: Whether the target orders memory accesses by a fence: always on x86, on ARM
            only where the device description enables the MemoryBarrier library.
        beat_ms: The longest time between two beats that the PLC promises: several scans of
            its slowest task.
        pins: Give blocks a pin for each top-level field.
    """

    folder: str = "ROS"
    prefix: str = "rosplc"
    fenced: bool = True
    beat_ms: int = 1000
    pins: bool = False
