"""Read-only looks at the objects of this machine: which there are, and how they stand.

Nothing is claimed and nothing is written: an observer uses no reader line, and the objects
are mapped read-only.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from rosplc.clock import SYSTEM, Clock
from rosplc.monitor.picture import ChannelView
from rosplc.monitor.states import State
from rosplc.monitor.watch import Watch

__all__ = ["ObjectState", "find_objects"]

_LOOKS = 4


@dataclass(frozen=True, slots=True)
class ObjectState:
    """One object as it stands.

    Attributes:
        prefix: The bridge's prefix.
        topic: As ROS writes it; the object's name where that cannot be known.
        path: The object's file.
        type_name: ``package/msg/Name``, empty if unreadable.
        direction: ``to_plc`` or ``to_ros``, empty if unreadable.
        record_size: Bytes of a record.
        slots: Number of slots.
        layout_id: 16 hexadecimal digits.
        bridge: The bridge's name.
        head: Sequence of the newest message.
        refused: Messages that the writer could not put into a record.
        truncated: Messages with something cut off.
        writer_alive: Whether the writer beat while looking.
        readers: Names of the tasks whose reader lines beat while looking.
        error: Why it cannot be read, as an error's text; empty if it can.
        code: The error's code.
    """

    prefix: str
    topic: str
    path: str
    type_name: str = ""
    direction: str = ""
    record_size: int = 0
    slots: int = 0
    layout_id: str = ""
    bridge: str = ""
    head: int = 0
    refused: int = 0
    truncated: int = 0
    writer_alive: bool = False
    readers: tuple[str, ...] = ()
    error: str = ""
    code: str = ""

    def to_dict(self) -> dict[str, Any]:
        """Return plain data for JSON."""
        return {name: getattr(self, name) for name in self.__slots__}


def find_objects(
    directory: str = "/dev/shm", *, prefix: str | None = None, seconds: float = 0.35, clock: Clock = SYSTEM
) -> list[ObjectState]:
    """Look at every object of this machine.

    Args:
        directory: Where the objects stand.
        prefix: Only those of this prefix; None for all.
        seconds: How long to watch beats; bridges beat every 0.1 s by default.
        clock: What beats are judged by.

    Returns:
        One state per object, sorted by prefix and topic; objects that cannot be read are
        there with their error.

    Raises:
        ChannelError: SHM118 if the prefix is not valid, SHM123 if the directory cannot be listed.
    """
    with Watch(prefix, directory=directory, clock=clock) as watch:
        picture = watch.look()
        for _ in range(_LOOKS if seconds and picture.channels else 0):
            clock.sleep(round(seconds / _LOOKS * 1e9))
            picture = watch.look()
    return [_state(view, directory) for view in picture.channels]


def _state(view: ChannelView, directory: str) -> ObjectState:
    path = str(Path(directory) / view.id)
    if view.state is State.UNREADABLE:
        return ObjectState(view.prefix, view.topic, path, error=view.words, code=view.code)
    return ObjectState(
        prefix=view.prefix,
        topic=view.topic,
        path=path,
        type_name=view.type_name,
        direction=view.direction,
        record_size=view.record_size,
        slots=view.slots,
        layout_id=view.layout_id,
        bridge=view.bridge,
        head=view.received,
        refused=view.refused,
        truncated=view.truncated,
        writer_alive=view.writer_alive is True,
        readers=tuple(each.task or f"process {each.pid}" for each in view.readers if each.alive),
    )
