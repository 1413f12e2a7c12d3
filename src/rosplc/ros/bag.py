"""A ROS 1 or ROS 2 recording as it stands in the file: topics, definitions as text, messages as bytes.

Nothing of a definition is executed and no message is decoded here, so a recording of unknown origin
may be read. :mod:`rosplc.ros.recording` translates messages between the two ROS worlds, and trusts
the file for that.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Any

from rosbags.interfaces import ConnectionExtRosbag1, MessageDefinitionFormat
from rosbags.rosbag1 import Reader as Reader1
from rosbags.rosbag2 import Reader as Reader2

from rosplc.errors import BackendError
from rosplc.ros.plain_file import unreadable_kind
from rosplc.ros.qos import Qos

__all__ = ["DAMAGE", "Bag", "BagTopic", "refuse_other_kinds"]

# A closed list had holes: SQLite's wrapper and the decompressors below rosbags have errors of their own.
DAMAGE = Exception
"""What a reader lets through when bytes of a file are not what they should be: anything."""


@dataclass(frozen=True, slots=True)
class BagTopic:
    """One topic of a recording, with one of the types it was recorded with.

    Attributes:
        name: The topic, as the file has it.
        type_name: ``package/msg/Name``, as the file has it.
        definition: The ``.msg`` text, with every type that it needs; empty where the file has none.
        publishers: Names of the nodes that published it, where the file tells.
        offered: The publishers' quality of service, where the file tells.
        count: Messages recorded.
    """

    name: str
    type_name: str
    definition: str = ""
    publishers: tuple[str, ...] = ()
    offered: tuple[Qos, ...] = ()
    count: int = 0


def refuse_other_kinds(path: Path) -> None:
    """Refuse what is neither a plain file nor a folder, before anything waits for it.

    Raises:
        BackendError: ROS006.
    """
    what, remedy = unreadable_kind(path)
    if what:
        raise BackendError("ROS006", f"recording cannot be read: {what}", where=str(path), remedy=remedy)


class Bag:
    """A recording, open for reading; a context manager.

    Args:
        path: A ``.bag``, ``.mcap`` or ``.db3`` file, or a folder of ``ros2 bag``.

    Attributes:
        path: As given.
        ros_version: 1 or 2.
        distro: The ROS distribution that the file names; empty if it names none.

    Raises:
        BackendError: ROS006, the file cannot be read.
    """

    def __init__(self, path: Path | str) -> None:
        self.path = Path(path)
        self.ros_version = 1 if self.path.suffix == ".bag" else 2
        self._reader: Any = None
        refuse_other_kinds(self.path)
        try:
            reader: Any = Reader1(self.path) if self.ros_version == 1 else Reader2(self.path)
            reader.open()
        except DAMAGE as error:
            raise self._unreadable(error) from error
        self._reader = reader
        self.distro = "noetic" if self.ros_version == 1 else str(reader.ros_distro or "")

    def __enter__(self) -> Bag:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

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
            is_text = connection.msgdef.format is MessageDefinitionFormat.MSG
            node, offered = _publisher(connection.ext)
            found[key] = BagTopic(
                *key,
                definition=before.definition or (connection.msgdef.data if is_text else ""),
                publishers=tuple(sorted({*before.publishers, *node})),
                offered=tuple(dict.fromkeys((*before.offered, *offered))),
                count=before.count + (connection.msgcount or 0),
            )
        return tuple(found[key] for key in sorted(found))

    def messages(self) -> Iterator[tuple[str, str, int, bytes]]:
        """Yield topic, type, time (ns since 1970) and bytes of every message, in their order.

        Raises:
            BackendError: ROS006, the file is damaged.
        """
        try:
            for connection, time_ns, data in self._reader.messages():
                yield connection.topic, connection.msgtype, time_ns, bytes(data)
        except DAMAGE as error:
            raise self._unreadable(error) from error

    def _unreadable(self, error: BaseException) -> BackendError:
        what = str(error).strip() or type(error).__name__
        return BackendError("ROS006", f"recording cannot be read: {what}", where=str(self.path))


def _publisher(ext: Any) -> tuple[tuple[str, ...], tuple[Qos, ...]]:
    """Return what a recording says of a topic's publishers: a name, or settings, or neither."""
    if isinstance(ext, ConnectionExtRosbag1):
        node = (str(ext.callerid),) if ext.callerid else ()
        return node, (Qos(durability="transient_local" if ext.latching else "volatile", depth=1),)
    offered = []
    for theirs in ext.offered_qos_profiles:
        reliable = theirs.reliability.name != "BEST_EFFORT"
        latched = theirs.durability.name == "TRANSIENT_LOCAL"
        offered.append(
            Qos(
                "reliable" if reliable else "best_effort",
                "transient_local" if latched else "volatile",
                min(max(1, theirs.depth), 100_000),
            )
        )
    return (), tuple(offered)
