"""Read-only looks at the objects of this machine: which there are, and how they stand.

Nothing is claimed and nothing is written: an observer uses no reader line, and the objects
are mapped read-only.
"""

from __future__ import annotations

import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from rosplc.errors import ChannelError
from rosplc.monitor.objects import object_prefix, open_object
from rosplc.shm import Attached, Direction, Namespace, Snapshot
from rosplc.shm.liveness import Liveness

__all__ = ["ObjectState", "find_objects", "look"]

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
    directory: str = "/dev/shm", *, prefix: str | None = None, seconds: float = 0.35
) -> list[ObjectState]:
    """Look at every object of this machine.

    Args:
        directory: Where the objects stand.
        prefix: Only those of this prefix; None for all.
        seconds: How long to watch beats; bridges beat every 0.1 s by default.

    Returns:
        One state per object, sorted by prefix and topic; objects that cannot be read are
        there with their error.

    Raises:
        ChannelError: SHM118 if the prefix is not valid, SHM123 if the directory cannot be listed.
    """
    if prefix is not None:
        Namespace(prefix, directory)
    try:
        names = sorted(entry.name for entry in Path(directory).iterdir())
    except OSError as error:
        raise ChannelError("SHM123", f"cannot list: {error.strerror}", where=directory) from error
    states: list[ObjectState] = []
    attached: list[tuple[ObjectState, Attached]] = []
    for name in names:
        found = object_prefix(name)
        if found is None or prefix not in (None, found):
            continue
        path = str(Path(directory) / name)
        topic = Namespace(found, directory).topic_of(name) or name
        state = ObjectState(found, topic, path)
        try:
            attached.append((state, open_object(path)))
        except ChannelError as error:
            states.append(ObjectState(found, topic, path, error=error.what, code=error.code))
    try:
        states += _watch(attached, seconds)
    finally:
        for _, each in attached:
            each.close()
    return sorted(states, key=lambda state: (state.prefix, state.topic))


class _Beats:
    def __init__(self, snapshot: Snapshot) -> None:
        self.writer = Liveness(snapshot.writer.beat_ms)
        self.readers = [Liveness(line.beat_ms) for line in snapshot.readers]
        self.writer_alive = False
        self.readers_alive = [False] * len(self.readers)

    def observe(self, snapshot: Snapshot, now_ns: int) -> None:
        writer = snapshot.writer
        self.writer_alive = self.writer.observe(writer.beat, writer.head, now_ns) and writer.epoch != 0
        self.readers_alive = [
            beats.observe(line.beat, line.taken, now_ns) and line.claim != 0
            for beats, line in zip(self.readers, snapshot.readers, strict=True)
        ]


def _watch(attached: list[tuple[ObjectState, Attached]], seconds: float) -> list[ObjectState]:
    beats = [_Beats(each.snapshot()) for _, each in attached]
    for look_number in range(_LOOKS + 1):
        if look_number:
            time.sleep(seconds / _LOOKS)
        now = time.monotonic_ns()
        for (_, each), beat in zip(attached, beats, strict=True):
            beat.observe(each.snapshot(), now)
        if not attached:
            break
    return [
        look(each, state, writer_alive=beat.writer_alive, readers_alive=beat.readers_alive)
        for (state, each), beat in zip(attached, beats, strict=True)
    ]


def look(
    attached: Attached, state: ObjectState, *, writer_alive: bool, readers_alive: list[bool]
) -> ObjectState:
    """Return the state of an attached object, what beats being known."""
    identity, snapshot = attached.identity, attached.snapshot()
    try:
        description = attached.description
    except ChannelError as error:
        return ObjectState(state.prefix, state.topic, state.path, error=error.what, code=error.code)
    return ObjectState(
        prefix=state.prefix,
        topic=description.topic,
        path=state.path,
        type_name=description.type,
        direction=Direction(identity.direction).word,
        record_size=identity.record_size,
        slots=identity.slot_count,
        layout_id=identity.layout_id,
        bridge=description.bridge,
        head=snapshot.writer.head,
        refused=snapshot.writer.refused,
        truncated=snapshot.writer.truncated,
        writer_alive=writer_alive,
        readers=tuple(
            line.task or f"process {line.pid}"
            for line, alive in zip(snapshot.readers, readers_alive, strict=True)
            if alive
        ),
    )
