"""The messages that ROS 2 makes of an action's own, as bytes: with a goal's UUID before them, or a status.

A UUID has 16 bytes, a multiple of every alignment of CDR: what follows it is encoded as if it came first.
Behind the one byte of a result's status that does not hold: a result has to be copied value by value.
"""

from __future__ import annotations

import struct
from collections.abc import Iterable
from typing import Any

from rosplc.errors import BackendError
from rosplc.model import TypeStore
from rosplc.model import types as kinds

LITTLE = b"\0\1\0\0"  # the header of plain CDR, little-endian
_GOAL_INFO = 24  # bytes: UUID, seconds, nanoseconds

GoalInfo = tuple[bytes, int]  # UUID, and the time of acceptance in ns since 1970
KnownGoal = tuple[bytes, int, int]  # the same, and the goal's status


def _short(what: str) -> BackendError:
    return BackendError("ROS008", f"a message of an action cannot be read: {what}")


def _read(layout: str, payload: bytes, at: int) -> tuple[Any, ...]:
    """Read values at an offset of a message's body, in its own byte order."""
    try:
        return struct.unpack_from(("<" if payload[1] & 1 else ">") + layout, payload, 4 + at)
    except (struct.error, IndexError) as error:
        raise _short(str(error)) from error


def _time(seconds: int, nanoseconds: int) -> int:
    return int(seconds) * 10**9 + int(nanoseconds)


def wrap(uuid: bytes, payload: bytes) -> bytes:
    """Return the request to send a goal, or the message that carries feedback."""
    return payload[:4] + uuid + payload[4:]


def unwrap(payload: bytes) -> tuple[bytes, bytes]:
    """Return UUID, and goal or feedback; of a request for a result, an empty message. ROS008 if too short."""
    if len(payload) < 20:
        raise _short(f"it has {len(payload)} bytes")
    return payload[4:20], payload[:4] + payload[20:]


def pack_accepted(accepted: bool, stamp_ns: int) -> bytes:
    """Return the response to a goal."""
    return LITTLE + struct.pack("<?3xiI", accepted, *divmod(stamp_ns, 10**9))


def read_accepted(payload: bytes) -> tuple[bool, int]:
    """Return whether a goal was accepted, and when; ROS008 if the bytes do not fit."""
    accepted, *stamp = _read("?3xiI", payload, 0)
    return accepted, _time(*stamp)


def pack_cancel(uuid: bytes, stamp_ns: int = 0) -> bytes:
    """Return the request to cancel goals."""
    return LITTLE + struct.pack("<16siI", uuid, *divmod(stamp_ns, 10**9))


def read_cancel(payload: bytes) -> GoalInfo:
    """Return the UUID and the time of a request to cancel; ROS008 if the bytes do not fit."""
    uuid, *stamp = _read("16siI", payload, 0)
    return uuid, _time(*stamp)


def pack_canceling(code: int, goals: Iterable[GoalInfo]) -> bytes:
    """Return the response to a request to cancel."""
    infos = [struct.pack("<16siI", uuid, *divmod(stamp_ns, 10**9)) for uuid, stamp_ns in goals]
    return LITTLE + struct.pack("<b3xI", code, len(infos)) + b"".join(infos)


def read_canceling(payload: bytes) -> tuple[int, list[GoalInfo]]:
    """Return code and goals of the response to a request to cancel; ROS008 if the bytes do not fit."""
    code, count = _read("b3xI", payload, 0)
    if count > len(payload) // _GOAL_INFO:
        raise _short(f"it announces {count} goals")
    found = [_read("16siI", payload, 8 + number * _GOAL_INFO) for number in range(count)]
    return code, [(uuid, _time(*stamp)) for uuid, *stamp in found]


def pack_statuses(goals: Iterable[KnownGoal]) -> bytes:
    """Return the message of the status topic."""
    known = list(goals)
    body = bytearray(len(known).to_bytes(4, "little"))
    for uuid, stamp_ns, status in known:
        body += uuid
        body += bytes(-len(body) % 4)
        body += struct.pack("<iIb", *divmod(stamp_ns, 10**9), status)
    return LITTLE + bytes(body)


def read_statuses(payload: bytes) -> list[KnownGoal]:
    """Return what the status topic tells; ROS008 if the bytes do not fit."""
    (count,) = _read("I", payload, 0)
    if count > len(payload) // _GOAL_INFO:
        raise _short(f"it announces {count} goals")
    found, at = [], 4
    for _ in range(count):
        (uuid,) = _read("16s", payload, at)
        at += 16 + -at % 4
        *stamp, status = _read("iIb", payload, at)
        at += 9
        found.append((uuid, _time(*stamp), status))
    return found


class Results:
    """Converts between a result and the response that has its status before it, or no result at all."""

    def __init__(self, store: TypeStore, result: kinds.MessageType) -> None:
        self._store, self._result = store, result

    def pack(self, status: int, result: bytes | None) -> bytes:
        """Return the response for a result, or for none the default one; ROS008 if the bytes do not fit."""
        copy = _Copy(self._store, result, 0)
        copy.out += struct.pack("b", status)
        copy.message(self._result)
        return copy.header + bytes(copy.out)

    def read(self, payload: bytes) -> tuple[int, bytes]:
        """Return status and result of a response; ROS008 if the bytes do not fit."""
        (status,) = _read("b", payload, 0)
        copy = _Copy(self._store, payload, 1)
        copy.message(self._result)
        return status, copy.header + bytes(copy.out)


class _Copy:
    """Copies values of CDR to where they are aligned differently; defaults if there is no source."""

    def __init__(self, store: TypeStore, source: bytes | None, at: int) -> None:
        self.header = LITTLE if source is None else source[:4]
        self.out = bytearray()
        self._store, self._at = store, at
        self._body = None if source is None else source[4:]

    def message(self, kind: kinds.MessageType) -> None:
        """Copy the fields of a message."""
        for field in kind.fields:
            self._value(field.type)
        if not kind.fields:
            self._block(1, 1)  # CDR has no empty structures

    def _value(self, kind: kinds.FieldType, count: int = 1) -> None:
        if isinstance(kind, kinds.PrimitiveType):
            self._block(kinds.PRIMITIVES[kind.name], count)
        elif isinstance(kind, kinds.ArrayType):
            self._value(kind.element, kind.length)
        elif isinstance(kind, kinds.SequenceType):
            if length := self._length(0):
                self._value(kind.element, length)
        else:
            for _ in range(count):
                if isinstance(kind, kinds.StringType):
                    self._block(1, self._length(1))
                elif isinstance(kind, kinds.NamedType):
                    self.message(self._store[kind.name])

    def _length(self, default: int) -> int:
        data = self._block(4, 1)
        order = "little" if self.header[1] & 1 else "big"
        if self._body is None:
            self.out[-4:] = default.to_bytes(4, "little")
            return default
        return int.from_bytes(data, order)  # type: ignore[arg-type]

    def _block(self, width: int, count: int) -> bytes:
        """Copy so many numbers of a width, aligned to it on both sides."""
        self.out += bytes(-len(self.out) % width)
        if self._body is None:
            data = bytes(width * count)
        else:
            self._at += -self._at % width
            data = self._body[self._at : self._at + width * count]
            if len(data) < width * count:
                raise _short(f"it ends after {len(self._body)} bytes")
            self._at += len(data)
        self.out += data
        return data
