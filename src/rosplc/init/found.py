"""The topics that a robot, or a recording of one, has, and measurements of their messages.

A message's bytes come from other programs and are not trusted: every length is checked against the remaining
bytes of the message, and the work for one message is bounded.
"""

from __future__ import annotations

import struct
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal

from rosplc.model import ArrayType, FieldType, NamedType, PrimitiveType, StringType, TypeStore
from rosplc.ros import Qos
from rosplc.ros.fields import Reader

_MOST_VISITS = 100_000
"""Values measured in one message; the bytes of a point cloud count as one value, its fields as ten more."""


@dataclass
class Seen:
    """Measurements of the messages of one topic.

    ``unreadable`` counts messages that did not fit the type. ``seconds`` is the duration of listening or of
    the recording; ``rate_hz`` the rate from the first to the last message, without those delivered when the
    subscription began, 0 with fewer than two; ``lengths`` has those of strings and sequences by field path;
    ``trouble`` is the reason why nothing could be received, in words.
    """

    messages: int = 0
    unreadable: int = 0
    seconds: float = 0.0
    rate_hz: float = 0.0
    longest_gap_s: float = 0.0
    lengths: dict[str, Length] = field(default_factory=dict)
    trouble: str = ""


@dataclass(slots=True)
class Length:
    """The lengths of one string (bytes) or sequence (elements), over all messages and enclosing elements."""

    least: int
    most: int

    def add(self, length: int) -> None:
        """Include one more length."""
        self.least = min(self.least, length)
        self.most = max(self.most, length)


class Meter:
    """Counts, times and measures the messages of one topic in ``seen``; used by one thread at a time.

    Messages in the first ``settle_ns`` do not count for the rate, because publishers that keep messages for
    late subscribers deliver all of them at once. If a message has too many values, only the first ones are in
    ``lengths``, whose keys are field paths as in a configuration's ``limits``.
    """

    def __init__(self, store: TypeStore, type_name: str, settle_ns: int = 0) -> None:
        self.seen = Seen()
        self._store = store
        self._type_name = type_name
        self._settle_ns = settle_ns
        self._first_ns: int | None = None
        self._last_ns = 0
        self._regular_from_ns = 0
        self._regular = 0

    def take(self, data: bytes, time_ns: int) -> None:
        """Measure a message that arrived at ``time_ns`` of any one clock; count it if it does not fit."""
        seen, first_ns = self.seen, self._first_ns
        if first_ns is None:
            self._first_ns = first_ns = self._last_ns = time_ns
        seen.longest_gap_s = max(seen.longest_gap_s, (time_ns - self._last_ns) / 1e9)
        self._last_ns = max(time_ns, self._last_ns)
        if not self._settle_ns or time_ns - first_ns >= self._settle_ns:
            self._regular_from_ns = self._regular_from_ns if self._regular else time_ns
            self._regular += 1
            lasted = (self._last_ns - self._regular_from_ns) / 1e9
            seen.rate_hz = (self._regular - 1) / lasted if lasted > 0 else 0.0
        lengths: dict[str, Length] = {}
        try:
            _Walk(self._store, data, lengths).measure(self._type_name)
        except _TooMuchError:
            pass
        except (ValueError, IndexError, struct.error):
            seen.unreadable += 1
            return
        seen.messages += 1
        for path, length in lengths.items():
            known = seen.lengths.setdefault(path, length)
            known.add(length.least)
            known.add(length.most)

    def finish(self, seconds: float, trouble: str = "") -> Seen:
        """Return the measurements of ``seconds`` of listening; ``trouble`` is kept only without messages."""
        self.seen.seconds = seconds
        self.seen.trouble = "" if self.seen.messages + self.seen.unreadable else trouble
        return self.seen


class _TooMuchError(Exception):
    """The message has more values than are measured."""


class _Walk(Reader):
    """Measures the lengths in a message, and reads no other values."""

    def __init__(self, store: TypeStore, data: bytes, lengths: dict[str, Length]) -> None:
        if store.ros_version == 2 and data[:2] not in (b"\0\0", b"\0\1"):
            raise ValueError("not plain CDR")
        super().__init__(store, data)
        self._lengths = lengths
        self._visits = 0

    def measure(self, type_name: str, path: str = "") -> None:
        fields = self._store[type_name].fields
        if not fields and not self._ros1:
            self._pass("uint8", 1)  # rosidl gives a message without fields one dummy byte
        for each in fields:
            self._visit(each.type, f"{path}{each.name}")

    def _visit(self, kind: FieldType, path: str) -> None:
        self._visits += 1
        if self._visits > _MOST_VISITS:
            raise _TooMuchError
        if isinstance(kind, PrimitiveType):
            self._pass(kind.name, 1)
        elif isinstance(kind, NamedType):
            self.measure(kind.name, f"{path}.")
        elif isinstance(kind, ArrayType):
            self._elements(kind.element, kind.length, path)
        elif isinstance(kind, StringType):
            self._pass("uint8", length := self._count())
            # Some peers send an empty one without its NUL.
            self._note(path, length if self._ros1 else max(0, length - 1))
        else:
            count = self._count()
            # An element may take no byte at all: ROS 1's std_msgs/Empty.
            may_be_empty = self._ros1 and isinstance(kind.element, NamedType)
            if count > len(self._body) - self._at and not may_be_empty:
                raise ValueError("a sequence exceeds the end of the message")
            self._note(path, count)
            self._elements(kind.element, count, path)

    def _elements(self, kind: FieldType, count: int, path: str) -> None:
        if isinstance(kind, PrimitiveType):
            self._pass(kind.name, count)
            return
        for _ in range(count):
            self._visit(kind, f"{path}[]")

    def _pass(self, name: str, count: int) -> None:
        self._skip(name, count)
        if self._at > len(self._body):
            raise ValueError("the message ends too early")

    def _note(self, path: str, length: int) -> None:
        self._lengths.setdefault(path, Length(length, length)).add(length)


@dataclass(frozen=True)
class Topic:
    """One topic that was found.

    ``types`` are those seen on it, ``package/msg/Name``: more than one is an error of the robot, none means
    that no node announced it. ``publishers`` and ``subscribers`` are node names, ``?`` for an unnamed node;
    ``offered`` has the publishers' quality of service, each once, ``hashes`` the announced type hashes;
    ``carried`` is the side to which a bridge carried the topic during the recording, ``plc`` or ``ros``.
    """

    name: str
    types: tuple[str, ...]
    publishers: tuple[str, ...] = ()
    subscribers: tuple[str, ...] = ()
    offered: tuple[Qos, ...] = ()
    hashes: tuple[str, ...] = ()
    carried: Literal["", "plc", "ros"] = ""


@dataclass(frozen=True)
class Call:
    """A service or action that was found: its ``kind``, its type, and the (proposed) side of its server."""

    kind: Literal["service", "action"]
    name: str
    type_name: str
    server: Literal["plc", "ros"]
    why: str


@dataclass(frozen=True)
class Found:
    """What was found: topics by name, and services and actions without those that every node has.

    ``where`` is the graph or recording in words; ``ros`` has the keys of the configuration's section ``ros``
    that lead to it, ``why`` the reason for each key; ``notes`` are further remarks.
    """

    topics: Mapping[str, Topic]
    where: str
    ros: Mapping[str, object]
    why: Mapping[str, str] = field(default_factory=dict)
    notes: tuple[str, ...] = ()
    calls: tuple[Call, ...] = ()
