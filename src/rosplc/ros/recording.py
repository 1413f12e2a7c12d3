"""Read a ROS 1 or ROS 2 recording as the ROS 2 messages that it stands for.

A ROS 1 recording is translated field by field into the types of a ROS 2 distribution. What
differs between the two worlds is mapped where a counterpart exists and named where it does
not, in :attr:`RecordedTopic.notes`:

* ``tf/tfMessage`` is ``tf2_msgs/msg/TFMessage``;
* ``rosgraph_msgs/Log`` is ``rcl_interfaces/msg/Log``: the stamp comes from the header, the
  levels 1, 2, 4, 8, 16 become 10, 20, 30, 40, 50;
* a field that the ROS 2 type lacks (``Header.seq``) is dropped, one that it has in addition
  keeps its zero value.

Types that the distribution does not bundle are taken from the recording itself. rosbags
turns definitions into code, so a recording is to be trusted like a program: replay your own.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Any

from rosbags.highlevel import AnyReader
from rosbags.interfaces import Connection, Nodetype
from rosbags.typesys import Stores, get_typestore
from rosbags.typesys.store import Typestore

from rosplc.errors import BackendError, MessageTypeError
from rosplc.ros.bag import DAMAGE, refuse_other_kinds

__all__ = ["RecordedMessage", "RecordedTopic", "Recording"]

_RENAMED = {
    "tf/msg/tfMessage": "tf2_msgs/msg/TFMessage",
    "rosgraph_msgs/msg/Log": "rcl_interfaces/msg/Log",
}
_LOG_LEVELS = {1: 10, 2: 20, 4: 30, 8: 40, 16: 50}


@dataclass(frozen=True, slots=True)
class RecordedTopic:
    """One topic of a recording.

    Attributes:
        name: The topic, ``/turtle1/pose``.
        source_type: The type in the recording, ``package/msg/Name``.
        type_name: The ROS 2 type that its messages are given as.
        definition: The ``.msg`` text that the recording carries for ``source_type``, with
            every type that it needs; empty where the recording carries none.
        bundled: Whether the ROS 2 distribution bundles ``type_name``.
        count: Messages recorded.
        notes: What was mapped or dropped between the two types, in words.
    """

    name: str
    source_type: str
    type_name: str
    definition: str
    bundled: bool
    count: int
    notes: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class RecordedMessage:
    """One message: when it was recorded (ns since the epoch) and its ROS 2 wire bytes (CDR)."""

    topic: str
    time_ns: int
    cdr: bytes


def _words(error: BaseException) -> str:
    return str(error).strip() or type(error).__name__


def _element(kind: Nodetype, argument: Any) -> tuple[Nodetype, Any]:
    """Return what a field consists of: its elements' type for a list, else its own."""
    if kind in (Nodetype.ARRAY, Nodetype.SEQUENCE):
        return argument[0][0], argument[0][1]
    return kind, argument


class Recording:
    """A recording, open for reading; a context manager.

    Args:
        path: A ``.bag`` file, an ``.mcap`` or ``.db3`` file's folder, or such a folder.
        distro: The ROS 2 distribution whose types the messages are given as.

    Raises:
        BackendError: ROS006, the file cannot be read.
        MessageTypeError: TYP006, the distribution is unknown or is not ROS 2.
    """

    def __init__(self, path: Path | str, distro: str = "jazzy") -> None:
        self.path = Path(path)
        try:
            self._target: Typestore = get_typestore(Stores[f"ROS2_{distro.upper()}"])
        except KeyError:
            raise MessageTypeError("TYP006", f"{distro!r} is not a bundled ROS 2 distribution") from None
        refuse_other_kinds(self.path)
        self._open = False
        self._notes: dict[str, list[str]] = {}
        self._bundled = frozenset(self._target.fielddefs)
        try:
            self._reader = AnyReader([self.path])
            self._reader.open()
            self._open = True
            self._register_missing()
            self._types = {c.topic: self._target_type(c.msgtype) for c in self._reader.connections}
            for connection in self._reader.connections:
                self._compare(connection.msgtype, self._types[connection.topic], "", connection.msgtype)
        except DAMAGE as error:
            self.close()
            what = f"recording cannot be read: {_words(error)}"
            raise BackendError("ROS006", what, where=str(self.path)) from error

    def __enter__(self) -> Recording:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def close(self) -> None:
        """Close the file."""
        if self._open:
            self._reader.close()
            self._open = False

    @property
    def topics(self) -> dict[str, RecordedTopic]:
        """Every topic of the recording by name, sorted."""
        result: dict[str, RecordedTopic] = {}
        for connection in sorted(self._reader.connections, key=lambda c: c.topic):
            before = result.get(connection.topic)
            result[connection.topic] = RecordedTopic(
                name=connection.topic,
                source_type=connection.msgtype,
                type_name=self._types[connection.topic],
                definition=connection.msgdef.data,
                bundled=self._types[connection.topic] in self._bundled,
                count=connection.msgcount + (before.count if before else 0),
                notes=tuple(self._notes.get(connection.msgtype, ())),
            )
        return result

    @property
    def start_ns(self) -> int:
        """When the first message was recorded (ns since the epoch)."""
        return self._reader.start_time

    @property
    def end_ns(self) -> int:
        """When the last message was recorded (ns since the epoch)."""
        return self._reader.end_time

    def definition(self, topic: str) -> str:
        """Return the definition of the type that a topic's messages are given as, in ROS 2's words."""
        return self._target.generate_msgdef(self._types[topic], ros_version=2)[0]

    def messages(self, topics: Collection[str] | None = None) -> Iterator[RecordedMessage]:
        """Yield every message in the order of recording.

        Args:
            topics: Only those of these topics; None for all.

        Raises:
            BackendError: ROS006, the file is damaged.
        """
        wanted = [one for one in self._reader.connections if topics is None or one.topic in topics]
        try:
            for connection, time_ns, raw in self._reader.messages(wanted) if wanted else ():
                yield RecordedMessage(connection.topic, time_ns, self._to_cdr(connection, raw))
        except DAMAGE as error:
            what = f"recording is damaged: {_words(error)}"
            raise BackendError("ROS006", what, where=str(self.path)) from error

    def value(self, message: RecordedMessage) -> Any:
        """Decode a message with the rosbags library, for comparison with what arrived elsewhere."""
        return self._target.deserialize_cdr(message.cdr, self._types[message.topic])

    def _target_type(self, source: str) -> str:
        return _RENAMED.get(source, source)

    def _register_missing(self) -> None:
        """Take the types that the distribution lacks from the recording."""
        source = self._reader.typestore.fielddefs
        missing: dict[str, Any] = {}

        def add(name: str) -> None:
            if self._target_type(name) != name or name in self._target.fielddefs or name in missing:
                return
            missing[name] = source[name]
            for _, (kind, argument) in source[name][1]:
                inner = _element(kind, argument)
                if inner[0] == Nodetype.NAME:
                    add(str(inner[1]))

        for connection in self._reader.connections:
            add(connection.msgtype)
        if missing:
            self._target.register(missing)

    def _compare(self, source: str, target: str, path: str, topic_type: str) -> None:
        """Note what differs between two types; the notes belong to the topic's type."""
        notes = self._notes.setdefault(topic_type, [])
        if not path and source != target:
            notes.append(f"{source} is given as {target}")
        source_fields = dict(self._reader.typestore.fielddefs[source][1])
        target_fields = dict(self._target.fielddefs[target][1])

        if source == "rosgraph_msgs/msg/Log" and target == "rcl_interfaces/msg/Log":
            notes.append("header.stamp is given as stamp; levels 1, 2, 4, 8, 16 as 10, 20, 30, 40, 50")
            notes.extend(f"{name} is dropped" for name in ("header.seq", "header.frame_id", "topics"))
            return
        for name, (kind, argument) in source_fields.items():
            where = f"{path}{name}"
            if name not in target_fields:
                notes.append(f"{where} is dropped: {target} has no such field")
                continue
            inner, other = _element(kind, argument), _element(*target_fields[name])
            if inner[0] == Nodetype.NAME:
                step = "." if inner == (kind, argument) else "[]."
                self._compare(str(inner[1]), str(other[1]), where + step, topic_type)
        notes.extend(
            f"{path}{name} stays zero: {source} has no such field"
            for name in target_fields
            if name not in source_fields
        )

    def _to_cdr(self, connection: Connection, raw: bytes) -> bytes:
        target = self._types[connection.topic]
        value: Any = self._reader.deserialize(raw, connection.msgtype)
        if connection.msgtype == "rosgraph_msgs/msg/Log":
            message = self._log(value)
        else:
            message = self._translate(value, target)
        return bytes(self._target.serialize_cdr(message, target))

    def _log(self, value: Any) -> Any:
        types = self._target.types
        stamp = value.header.stamp
        return types["rcl_interfaces/msg/Log"](
            stamp=types["builtin_interfaces/msg/Time"](sec=stamp.sec, nanosec=stamp.nanosec),
            level=_LOG_LEVELS.get(value.level, value.level),
            name=value.name,
            msg=value.msg,
            file=value.file,
            function=value.function,
            line=value.line,
        )

    def _translate(self, value: Any, target: str) -> Any:
        """Rebuild ``value`` as the target store's class, field by field."""
        fields: dict[str, Any] = {}
        for name, (kind, argument) in self._target.fielddefs[target][1]:
            if not hasattr(value, name):
                fields[name] = self._zero(kind, argument)
                continue
            part = getattr(value, name)
            if kind == Nodetype.NAME:
                part = self._translate(part, str(argument))
            elif kind in (Nodetype.ARRAY, Nodetype.SEQUENCE) and argument[0][0] == Nodetype.NAME:
                part = [self._translate(item, str(argument[0][1])) for item in part]
            fields[name] = part
        return self._target.types[target](**fields)

    def _zero(self, kind: Nodetype, argument: Any) -> Any:
        if kind == Nodetype.NAME:
            return self._translate(object(), str(argument))
        if kind == Nodetype.SEQUENCE:
            return []
        if kind == Nodetype.ARRAY:
            return [self._zero(*argument[0]) for _ in range(argument[1])]
        return {"string": "", "bool": False, "float32": 0.0, "float64": 0.0}.get(argument[0], 0)
