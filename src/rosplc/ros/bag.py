"""The raw content of a ROS 1 or ROS 2 recording: topics, definitions as text, messages as bytes.

No definition is executed and no message is decoded here, so recordings of unknown origin can be read
safely.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import apsw
from rosbags.interfaces import ConnectionExtRosbag1, MessageDefinitionFormat
from rosbags.rosbag1 import Reader as Reader1
from rosbags.rosbag2 import Reader as Reader2
from rosbags.typesys import Stores, get_types_from_idl, get_typestore

from rosplc.errors import BackendError
from rosplc.ros.backend import Durability, Qos, Reliability
from rosplc.ros.plain_file import unreadable_kind

# A closed list had holes: SQLite's wrapper and the decompressors below rosbags have errors of their own.
DAMAGE = Exception  # What a reader lets through when bytes of a file are not what they should be: anything.


@dataclass(frozen=True, slots=True)
class BagTopic:
    """One topic of a recording, with one of the types it was recorded with."""

    name: str  # the topic, as the file has it
    type_name: str  # ``package/msg/Name``, as the file has it
    definition: str = ""  # the ``.msg`` text, with every type that it needs; empty where the file has none
    several: bool = False  # whether it was recorded with further definitions of the same type
    publishers: tuple[str, ...] = ()  # names of the nodes that published it, where the file tells
    offered: tuple[Qos, ...] = ()  # the publishers' quality of service, where the file tells
    count: int = 0  # messages recorded


class Bag:
    """A recording, open for reading: ``.bag``, ``.mcap``, ``.db3``, or a folder of ``ros2 bag``.

    Raises BackendError ROS006.
    """

    def __init__(self, path: Path | str) -> None:
        self.path = Path(path)
        self.ros_version = 1 if self.path.suffix == ".bag" else 2  # 1 or 2
        self._reader: Any = None
        what, remedy = unreadable_kind(self.path)  # before anything waits for a pipe
        if what:
            raise BackendError("ROS006", f"recording cannot be read: {what}", where=str(path), remedy=remedy)
        try:
            reader: Any = Reader1(self.path) if self.ros_version == 1 else Reader2(self.path)
            with _without_unknown_definitions():
                reader.open()
        except DAMAGE as error:
            raise self._unreadable(error) from error
        self._reader = reader
        # the ROS distribution that the file names; empty if it names none
        self.distro = "noetic" if self.ros_version == 1 else str(reader.ros_distro or "")

    def close(self) -> None:
        """Close the file."""
        if self._reader is not None:
            self._reader.close()
            self._reader = None

    def topics(self) -> tuple[BagTopic, ...]:
        """Return every topic, sorted by name and type."""
        found: dict[tuple[str, str], BagTopic] = {}
        for connection in self._reader.connections:
            key = (str(connection.topic), str(connection.msgtype))
            before = found.get(key, BagTopic(*key))
            definition = _definition(connection)
            node, offered = _publisher(connection.ext)
            found[key] = BagTopic(
                *key,
                definition=before.definition or definition,
                several=before.several or bool(before.definition and definition != before.definition),
                publishers=tuple(sorted({*before.publishers, *node})),
                offered=tuple(dict.fromkeys((*before.offered, *offered))),
                count=before.count + (connection.msgcount or 0),
            )
        return tuple(found[key] for key in sorted(found))

    def span(self) -> tuple[int, int]:
        """Return the times of the first and last message (ns since 1970); 0 if there are no messages."""
        if not self._reader.message_count:
            return 0, 0
        return int(self._reader.start_time), int(self._reader.end_time)

    def messages(self, topics: Collection[str] | None = None) -> Iterator[tuple[str, str, int, bytes]]:
        """Yield topic, type, time (ns since 1970) and bytes of each message (of these topics), in order.

        Raises BackendError: ROS006, the file is damaged.
        """
        wanted = [one for one in self._reader.connections if topics is None or one.topic in topics]
        try:
            for connection, time_ns, data in self._reader.messages(wanted) if wanted else ():
                yield connection.topic, connection.msgtype, time_ns, bytes(data)
        except DAMAGE as error:
            raise self._unreadable(error) from error

    def _unreadable(self, error: BaseException) -> BackendError:
        what = str(error).strip() or type(error).__name__
        return BackendError("ROS006", f"recording cannot be read: {what}", where=str(self.path))


@contextmanager
def _without_unknown_definitions() -> Iterator[None]:
    """Hide types without a recorded definition from rosbags, which would refuse the whole file."""

    def row(cursor: apsw.Cursor, found: tuple[Any, ...]) -> tuple[Any, ...] | None:
        is_definition = len(found) == 4 and cursor.description[1][0] == "encoding"
        return None if is_definition and found[1] not in ("ros2msg", "ros2idl") else found

    def hook(connection: apsw.Connection) -> None:
        connection.row_trace = row

    apsw.connection_hooks.append(hook)
    try:
        yield
    finally:
        apsw.connection_hooks.remove(hook)


def _definition(connection: Any) -> str:
    """Return a connection's definition as ``.msg`` text; empty if the file has no usable definition."""
    form, text = connection.msgdef.format, str(connection.msgdef.data)
    if form is not MessageDefinitionFormat.IDL:
        return text if form is MessageDefinitionFormat.MSG else ""
    store = get_typestore(Stores.EMPTY)
    try:
        for part in text.split("=" * 80 + "\n"):
            idl = part.partition("\n")[2] if part.startswith("IDL:") else part
            store.fielddefs.update(get_types_from_idl(idl))
        return store.generate_msgdef(connection.msgtype, ros_version=2)[0]
    except DAMAGE:
        return ""


def _publisher(ext: Any) -> tuple[tuple[str, ...], tuple[Qos, ...]]:
    """Return what a recording contains about a topic's publishers: a name, QoS settings, or neither."""
    if isinstance(ext, ConnectionExtRosbag1):
        node = (str(ext.callerid),) if ext.callerid else ()
        return node, (Qos(durability="transient_local" if ext.latching else "volatile", depth=1),)
    offered = []
    for theirs in ext.offered_qos_profiles:
        reliability: Reliability = "best_effort" if theirs.reliability.name == "BEST_EFFORT" else "reliable"
        durability: Durability = (
            "transient_local" if theirs.durability.name == "TRANSIENT_LOCAL" else "volatile"
        )
        offered.append(Qos(reliability, durability, min(max(1, theirs.depth), 100_000)))
    return (), tuple(offered)
