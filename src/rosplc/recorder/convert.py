"""Messages of one definition as messages of another: fields are matched by name, never by position.

Recordings may be of unknown origin: no definition is executed, and lengths are checked before reading.
"""

from __future__ import annotations

from array import array
from collections.abc import Callable, Mapping
from typing import Any

from rosplc.errors import CodecError, RecordingError, RosplcError
from rosplc.model import TypeStore
from rosplc.model.types import (
    PRIMITIVES,
    ArrayType,
    FieldType,
    MessageType,
    NamedType,
    PrimitiveType,
    SequenceType,
    StringType,
)

RENAMED = {"tf/msg/tfMessage": "tf2_msgs/msg/TFMessage", "rosgraph_msgs/msg/Log": "rcl_interfaces/msg/Log"}
"""ROS 1 type → the ROS 2 type that took its place."""

_LOG = ("rosgraph_msgs/msg/Log", "rcl_interfaces/msg/Log")
_LOG_LEVELS = {1: 10, 2: 20, 4: 30, 8: 40, 16: 50}
_LOG_NOTES = (
    "header.stamp is given as stamp; levels 1, 2, 4, 8, 16 as 10, 20, 30, 40, 50",
    *(f"{name} is dropped" for name in ("header.seq", "header.frame_id", "topics")),
)
_SWAP = {2: "H", 4: "I", 8: "Q"}
_MOST_CALLS = 4096
_ENCAPSULATION = b"\0\1\0\0"  # CDR, little-endian

_Read = Callable[["_In"], Any]
_Write = Callable[["_Out", Any], None]


def renamed(type_name: str, store: TypeStore) -> str:
    """Return what a recorded type is called among the types of a store."""
    new = RENAMED.get(type_name, type_name)
    return new if type_name not in store and new in store else type_name


class Conversion:
    """Turns messages of one definition into messages of another, in CDR or ROS 1's serialization.

    A field that only the source has is dropped, one that only the target has stays zero; both are noted.
    ``where`` is the topic, for errors. Raises RecordingError REC007 if a field has two types that do not
    agree, or the two definitions have no field in common.
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
        self._source, self._target, self._where = source, target, where
        self._from_ros1, self._to_ros1 = from_ros1, to_ros1
        self.notes: list[str] = []  # what differs between the two
        self.unchanged = from_ros1 == to_ros1  # whether a message's bytes are the same under both
        if source_type != target_type:
            self.notes.append(f"{source_type} is given as {target_type}")
        self._is_log = (source_type, target_type) == _LOG
        own = source[source_type]
        if self._is_log:
            self.notes.extend(_LOG_NOTES)
            self.unchanged = False
            shape = {field.name: field.type for field in own.fields}
            shape["stamp"] = NamedType("builtin_interfaces/msg/Time")
            self._write = self._struct(shape, target[target_type], "", source_type, noted=False)
        else:
            self._write = self._message(own, target[target_type], "")
        self._read = self._reader(NamedType(own.name))

    def __call__(self, data: bytes) -> bytes | None:
        """Return a message under the target's definition; None if there is nothing to be sent.

        Raises CodecError COD001, COD002, COD003 or COD008 if it does not fit one of the two definitions.
        """
        if self.unchanged:
            return data
        given = _In(data, cdr=not self._from_ros1)
        value = self._read(given)
        given.end()
        if self._is_log:
            [level] = value["level"]
            value |= {"stamp": value["header"]["stamp"], "level": bytes([_LOG_LEVELS.get(level, level)])}
        out = _Out(cdr=not self._to_ros1)
        self._write(out, value)
        return out.finished()

    # -- reading

    def _reader(self, kind: FieldType) -> _Read:
        if isinstance(kind, NamedType):
            fields = [(field.name, self._reader(field.type)) for field in self._source[kind.name].fields]
            hidden = not fields and not self._from_ros1  # what ROS 2 gives a message without fields
            return lambda one: one.take(1, 1) if hidden else {name: read(one) for name, read in fields}
        if isinstance(kind, StringType):
            return _In.string
        if isinstance(kind, PrimitiveType):
            size = PRIMITIVES[kind.name]
            return lambda one: one.numbers(size, 1)
        counted = isinstance(kind, SequenceType)
        length = 0 if isinstance(kind, SequenceType) else kind.length
        if isinstance(kind.element, PrimitiveType):
            size = PRIMITIVES[kind.element.name]
            return lambda one: one.numbers(size, one.count() if counted else length)
        element = self._reader(kind.element)
        return lambda one: [element(one) for _ in range(one.count() if counted else length)]

    # -- writing

    def _message(self, own: MessageType, wanted: MessageType, path: str) -> _Write:
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
                self.notes.append(f"{path}* are in another order in {wanted.name}; they are matched by name")
        return self._struct(shape, wanted, path, own.name)

    def _struct(
        self, shape: Mapping[str, FieldType], wanted: MessageType, path: str, own: str, *, noted: bool = True
    ) -> _Write:
        writes: list[tuple[str, _Write]] = []
        for field in wanted.fields:
            if field.name in shape:
                writes.append((field.name, self._field(shape[field.name], field.type, f"{path}{field.name}")))
            else:
                writes.append(("", self._zero(field.type)))
                if noted:
                    self.notes.append(f"{path}{field.name} stays zero: {own} has no such field")
        hidden = not writes and not self._to_ros1

        def write(out: _Out, value: Any) -> None:
            if hidden:
                out.put(b"\0", 1)
            for name, one in writes:
                one(out, value[name] if name else None)

        return write

    def _field(self, own: FieldType, wanted: FieldType, path: str) -> _Write:
        if isinstance(own, NamedType) and isinstance(wanted, NamedType):
            return self._message(self._source[own.name], self._target[wanted.name], f"{path}.")
        if isinstance(own, StringType) and isinstance(wanted, StringType):
            return self._string(own, wanted, path)
        if isinstance(own, PrimitiveType) and isinstance(wanted, PrimitiveType):
            if own.name == wanted.name or _both_bytes(own, wanted):
                size = PRIMITIVES[own.name]
                return lambda out, value: out.put(value, size)
        elif isinstance(own, ArrayType) and isinstance(wanted, ArrayType) and own.length == wanted.length:
            return self._list(own.element, wanted.element, path, None)
        elif isinstance(own, SequenceType) and isinstance(wanted, SequenceType):
            bound = (1 << 32) - 1 if wanted.bound is None else wanted.bound
            if wanted.bound is not None and wanted.bound != own.bound:
                self.unchanged = False
            return self._list(own.element, wanted.element, path, bound)
        raise self._refused(f"its field {path} was recorded as {own}, and {wanted} is wanted")

    def _string(self, own: StringType, wanted: StringType, path: str) -> _Write:
        if wanted.bound is not None and wanted.bound != own.bound:
            self.unchanged = False

        def write(out: _Out, value: bytes) -> None:
            if wanted.bound is not None and len(value) > wanted.bound:
                raise CodecError("COD008", f"{len(value)} bytes, {wanted.bound} are the most", where=path)
            out.string(value)

        return write

    def _list(self, own: FieldType, wanted: FieldType, path: str, bound: int | None) -> _Write:
        flat = PRIMITIVES[own.name] if isinstance(own, PrimitiveType) else 0
        element = self._field(own, wanted, f"{path}[]")

        def write(out: _Out, value: Any) -> None:
            count = len(value) // flat if flat else len(value)
            if bound is not None:
                if count > bound:
                    raise CodecError("COD008", f"{count} elements, {bound} are the most", where=path)
                out.put(count.to_bytes(4, "little"), 4)
            if flat:
                if count:
                    out.put(value, flat)
                return
            for one in value:
                element(out, one)

        return write

    def _zero(self, wanted: FieldType) -> _Write:
        if isinstance(wanted, NamedType):
            return self._struct({}, self._target[wanted.name], "", "", noted=False)
        if isinstance(wanted, StringType):
            return lambda out, _: out.string(b"")
        if isinstance(wanted, PrimitiveType):
            size = PRIMITIVES[wanted.name]
            return lambda out, _: out.put(bytes(size), size)
        if isinstance(wanted, SequenceType):
            return lambda out, _: out.put(bytes(4), 4)
        element, length = self._zero(wanted.element), wanted.length

        def write(out: _Out, _: Any) -> None:
            for _ in range(length):
                element(out, None)

        return write

    def _refused(self, what: str) -> RosplcError:
        return RecordingError(
            "REC007",
            f"the definitions do not agree: {what}",
            where=self._where,
            remedy="Use the definition that it was recorded with, or leave it out with "
            f"--exclude {self._where}.",
        )


class Requests(Conversion):
    """Takes the requests out of a service's events, or the goals out of an action's.

    An event that is no request is nothing; nor is what another event, of the other side, has told already.
    Raises RecordingError REC007 if the definitions of the parts do not agree.
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
        self._event = self._reader(NamedType(f"{name}{'_SendGoal' * self._is_goal}_Event"))
        self._seen: dict[bytes, bytes] = {}

    def __call__(self, data: bytes) -> bytes | None:
        """Return the request or goal; CodecError too if the recording has none of its content."""
        given = _In(data, cdr=True)
        event = self._event(given)
        given.end()
        about = event["info"]
        kind, call = about["event_type"], about["client_gid"] + about["sequence_number"]
        if kind[0] > 1:  # neither REQUEST_SENT nor REQUEST_RECEIVED
            return None
        if len(self._seen) >= _MOST_CALLS:
            self._seen.clear()
        if self._seen.setdefault(call, kind) != kind:
            return None
        if not event["request"]:
            raise CodecError("COD001", "the recording has only the fact of the request", where=self._where)
        [request] = event["request"]
        out = _Out(cdr=not self._to_ros1)
        self._write(out, request["goal"] if self._is_goal else request)
        return out.finished()


def _both_bytes(own: PrimitiveType, wanted: PrimitiveType) -> bool:
    """Return whether two types are the same 8 bits under other names; ROS 1 has a signed byte."""
    names = {own.name, wanted.name}
    return names <= {"byte", "char", "uint8"} or (
        "byte" in (str(own), str(wanted)) and names <= {"byte", "char", "uint8", "int8"}
    )


class _In:
    """A message that is being read; numbers come out little-endian."""

    def __init__(self, data: bytes, *, cdr: bool) -> None:
        self._data, self._cdr = data, cdr
        self._at, self._big = 0, False
        if cdr:
            kind = self.take(4, 1)[:2]
            if kind not in (b"\0\0", b"\0\1"):
                raise CodecError("COD003", f"encapsulation 0x{kind.hex()} is neither 0x0000 nor 0x0001")
            self._big = kind == b"\0\0"

    def take(self, size: int, align: int) -> bytes:
        begin = self._at + ((4 - self._at) % align if self._cdr else 0)
        self._at = begin + size
        if self._at > len(self._data):
            raise CodecError("COD001", f"{size} bytes at byte {begin}, where {len(self._data)} are in all")
        return self._data[begin : self._at]

    def numbers(self, size: int, count: int) -> bytes:
        if not count:
            return b""
        raw = self.take(size * count, size)
        if self._big and size > 1:
            swapped = array(_SWAP[size], raw)
            swapped.byteswap()
            return swapped.tobytes()
        return raw

    def count(self) -> int:
        count = int.from_bytes(self.numbers(4, 1), "little")
        if count > len(self._data):  # elements of no size would be counted without end
            raise CodecError("COD001", f"{count} elements in {len(self._data)} bytes")
        return count

    def end(self) -> None:
        rest = len(self._data) - self._at
        if rest > (3 if self._cdr else 0):
            raise CodecError("COD002", f"{rest} bytes are left over")

    def string(self) -> bytes:
        raw = self.take(self.count(), 1)
        return raw[:-1] if self._cdr else raw


class _Out:
    """A message that is being written, little-endian."""

    def __init__(self, *, cdr: bool) -> None:
        self._cdr = cdr
        self._data = bytearray(_ENCAPSULATION if cdr else b"")

    def put(self, raw: bytes, align: int) -> None:
        if self._cdr:
            self._data += bytes((4 - len(self._data)) % align)
        self._data += raw

    def string(self, value: bytes) -> None:
        end = b"\0" if self._cdr else b""
        self.put((len(value) + len(end)).to_bytes(4, "little"), 4)
        self._data += value + end

    def finished(self) -> bytes:
        if self._cdr:
            self._data += bytes(-len(self._data) % 4)
        return bytes(self._data)
