"""Converts messages from one definition to another: fields are matched by name, never by position.

Recordings may be of unknown origin: no definition is executed, and lengths are checked before reading.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from rosplc.errors import CodecError, RecordingError, RosplcError
from rosplc.model import TypeStore
from rosplc.model.types import (
    ArrayType,
    Field,
    FieldType,
    MessageType,
    NamedType,
    PrimitiveType,
    SequenceType,
    StringType,
)
from rosplc.ros import ROS1, fields

RENAMED = {"tf/msg/tfMessage": "tf2_msgs/msg/TFMessage", "rosgraph_msgs/msg/Log": "rcl_interfaces/msg/Log"}
"""ROS 1 type → the ROS 2 type that replaced it."""

_LOG = ("rosgraph_msgs/msg/Log", "rcl_interfaces/msg/Log")
_LOG_LEVELS = {1: 10, 2: 20, 4: 30, 8: 40, 16: 50}
_LOG_NOTES = (
    "header.stamp becomes stamp; levels 1, 2, 4, 8, 16 become 10, 20, 30, 40, 50",
    *(f"{name} is dropped" for name in ("header.seq", "header.frame_id", "topics")),
)
_BYTES = {"byte", "char", "uint8"}
_MOST_CALLS = 4096

_Change = Callable[[Any], Any]
_Bound = StringType | SequenceType


def renamed(type_name: str, store: TypeStore) -> str:
    """Return the name of a recorded type in a store."""
    new = RENAMED.get(type_name, type_name)
    return new if type_name not in store and new in store else type_name


class Conversion:
    """Converts messages from one definition to another, in CDR or ROS 1 serialization.

    A field that only the source has is dropped; a field that only the target has stays zero; both are noted.
    ``where`` is the topic, for errors. Raises RecordingError REC007 if a field has incompatible types, or the
    two definitions have no field in common.
    """

    def __init__(
        self,
        source: TypeStore,
        source_type: str,
        target: TypeStore,
        target_type: str,
        *,
        from_ros1: bool = False,
        to_ros1: bool = False,
        where: str = "",
    ) -> None:
        own, wanted, self._where, self._type = source[source_type], target[target_type], where, target_type
        self._source = _on_wire(source, source_type, from_ros1)
        self._target = _on_wire(target, target_type, to_ros1)
        self.notes: list[str] = []  # what differs between the two
        self.unchanged = from_ros1 == to_ros1  # whether a message's bytes are the same under both
        if source_type != target_type:
            self.notes.append(f"{source_type} is converted to {target_type}")
        self._own, self._is_log = own.name, (source_type, target_type) == _LOG
        if self._is_log:
            self.notes.extend(_LOG_NOTES)
            self.unchanged = False
            stamp = Field("stamp", NamedType("builtin_interfaces/msg/Time"))
            kept = (field for field in own.fields if field.name not in ("header", "topics"))
            own = MessageType(source_type, (stamp, *kept))
        self._change = self._message(own, wanted, "")

    def __call__(self, data: bytes) -> bytes | None:
        """Return a message in the target's definition; None if there is nothing to send.

        Raises CodecError COD001, COD002, COD003 or COD008 if it does not fit one of the two definitions.
        """
        if self.unchanged:
            return data
        value = fields.unpack_whole(self._source, self._own, data)
        if self._is_log:
            level = value["level"]
            value |= {"stamp": value["header"]["stamp"], "level": _LOG_LEVELS.get(level, level)}
        return self._written(value)

    def _written(self, value: Any) -> bytes:
        data = fields.pack(self._target, self._type, self._change(value))
        return data if self._target.ros_version == 1 else data + bytes(-len(data) % 4)

    def _message(self, own: MessageType, wanted: MessageType, path: str) -> _Change:
        shape = {field.name: field.type for field in own.fields}
        names, wanted_names = list(shape), [field.name for field in wanted.fields]
        self.notes.extend(
            f"{path}{name} is dropped: {wanted.name} has no such field"
            for name in names
            if name not in wanted_names
        )
        if names != wanted_names:
            self.unchanged = False
            common = set(names) & set(wanted_names)
            if names and wanted_names and not common:
                raise self._refused(f"{own.name} and {wanted.name} have no field in common")
            if [n for n in names if n in common] != [n for n in wanted_names if n in common]:
                self.notes.append(f"{path}* have another order in {wanted.name}; they are matched by name")
        changes: dict[str, _Change] = {}
        for field in wanted.fields:
            if field.name in shape:
                changes[field.name] = self._field(shape[field.name], field.type, f"{path}{field.name}")
            else:
                self.notes.append(f"{path}{field.name} stays zero: {own.name} has no such field")
        return lambda value: {name: change(value[name]) for name, change in changes.items()}

    def _field(self, own: FieldType, wanted: FieldType, path: str) -> _Change:
        if isinstance(own, NamedType) and isinstance(wanted, NamedType):
            return self._message(self._source[own.name], self._target[wanted.name], f"{path}.")
        if isinstance(own, StringType) and isinstance(wanted, StringType):
            return self._bounded(_same, own, wanted, path)
        if isinstance(own, PrimitiveType) and isinstance(wanted, PrimitiveType):
            if own.name == wanted.name or {own.name, wanted.name} <= _BYTES:
                return _same
            if {own.name, wanted.name} <= {*_BYTES, "int8"} and "byte" in (str(own), str(wanted)):
                most = 127 if wanted.name == "int8" else 255  # the same 8 bits: ROS 1 has a signed byte
                return lambda value: value % 256 - 256 * (value % 256 > most)
        elif isinstance(own, ArrayType) and isinstance(wanted, ArrayType) and own.length == wanted.length:
            return self._elements(own.element, wanted.element, path)
        elif isinstance(own, SequenceType) and isinstance(wanted, SequenceType):
            return self._bounded(self._elements(own.element, wanted.element, path), own, wanted, path)
        raise self._refused(f"field {path} was recorded as {own}, but must be {wanted}")

    def _elements(self, own: FieldType, wanted: FieldType, path: str) -> _Change:
        change = self._field(own, wanted, f"{path}[]")
        return _same if change is _same else lambda value: [change(one) for one in value]

    def _bounded(self, change: _Change, own: _Bound, wanted: _Bound, path: str) -> _Change:
        bound, what = wanted.bound, "bytes" if isinstance(wanted, StringType) else "elements"
        if bound is None:
            return change
        self.unchanged = self.unchanged and bound == own.bound

        def checked(value: Any) -> Any:
            count = len(value.encode(errors="surrogateescape") if isinstance(value, str) else value)
            if count > bound:
                raise CodecError("COD008", f"{count} {what}; the limit is {bound}", where=path)
            return change(value)

        return checked

    def _refused(self, what: str) -> RosplcError:
        return RecordingError(
            "REC007",
            f"the definitions do not match: {what}",
            where=self._where,
            remedy=f"Use the recorded definition, or exclude the topic with --exclude {self._where}.",
        )


class Requests(Conversion):
    """Extracts the requests from a service's events, or the goals from an action's.

    Events that are not requests are ignored, as are requests that an event of the other side also contains.
    Raises RecordingError REC007 if the definitions of the parts do not match.
    """

    def __init__(
        self, source: TypeStore, name: str, target: TypeStore, *, to_ros1: bool = False, where: str = ""
    ) -> None:
        self._is_goal = "/action/" in name
        asked, *answers = ("Goal", "Result", "Feedback") if self._is_goal else ("Request", "Response")
        for part in (f"{name}_{answer}" for answer in answers):
            Conversion(source, part, target, part, to_ros1=to_ros1, where=where)
        own = f"{name}_{asked}"
        super().__init__(source, own, target, own, to_ros1=to_ros1, where=where)
        self._event = f"{name}{'_SendGoal' * self._is_goal}_Event"
        self._events = _on_wire(source, self._event, False)
        self._seen: dict[tuple[bytes, int], int] = {}

    def __call__(self, data: bytes) -> bytes | None:
        """Return the request or goal; also raises CodecError if its content was not recorded."""
        event = fields.unpack_whole(self._events, self._event, data)
        about = event["info"]
        kind, call = about["event_type"], (about["client_gid"], about["sequence_number"])
        if kind > 1:  # neither REQUEST_SENT nor REQUEST_RECEIVED
            return None
        if len(self._seen) >= _MOST_CALLS:
            self._seen.clear()
        if self._seen.setdefault(call, kind) != kind:
            return None
        if not event["request"]:
            raise CodecError("COD001", "the content of the request was not recorded", where=self._where)
        [request] = event["request"]
        return self._written(request["goal"] if self._is_goal else request)


def _same(value: Any) -> Any:
    return value


def _on_wire(store: TypeStore, name: str, ros1: bool) -> TypeStore:
    """Return a store with a type and those that it uses, for the ROS version of its serialization."""
    return TypeStore(ROS1 if ros1 else "", {each: store[each] for each in store.dependencies(name)})
