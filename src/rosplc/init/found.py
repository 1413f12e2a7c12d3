"""What a robot, or a recording of one, shows of itself: the topics, and what their messages were like.

A message's bytes come from other programs and are not trusted: every length is checked against what is left
of the message, and the work for one message is bounded.
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
"""Values looked at in one message; a point cloud's bytes are one, its fields another ten."""


@dataclass
class Seen:
    """What the messages of one topic were like.

    ``unreadable`` did not fit the type. ``seconds`` is how long was listened, or how long the recording is;
    ``rate_hz`` from the first to the last message, without what was delivered at once when the subscription
    began, 0 with fewer than two; ``lengths`` of strings and sequences by field path; ``trouble`` why nothing
    could be received, in words.
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
    """The lengths of one string (bytes) or sequence (elements), over all messages and elements above it."""

    least: int
    most: int

    def add(self, length: int) -> None:
        """Take one more into account."""
        self.least = min(self.least, length)
        self.most = max(self.most, length)


class Meter:
    """Counts, times and measures the messages of one topic: ``seen``; used by one thread at a time.

    For ``settle_ns`` from the first message on none counts for the rate: publishers that keep messages for
    those who come later deliver all of them at once. Of a message with more values than are looked at, those
    that came first are in ``lengths``, by field path as a configuration's ``limits`` write it.
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
        """Take a message that came at ``time_ns`` of any one clock; one that does not fit is counted."""
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
        """Return what was seen in ``seconds`` of listening; ``trouble`` counts if that was nothing."""
        self.seen.seconds = seconds
        self.seen.trouble = "" if self.seen.messages + self.seen.unreadable else trouble
        return self.seen


class _TooMuchError(Exception):
    """The message has more values than are looked at."""


class _Walk(Reader):
    """Measures what it goes through, and reads nothing but lengths."""

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
                raise ValueError("a sequence is longer than the message")
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
    that no node announced it. ``publishers`` and ``subscribers`` name nodes, ``?`` one without a name;
    ``offered`` has the publishers' quality of service, each once, ``hashes`` the type hashes announced;
    ``carried`` is where a bridge took it when it was recorded, ``plc`` or ``ros``.
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
    """A service or action that was found: its ``kind``, its type, and where its server is, or should be."""

    kind: Literal["service", "action"]
    name: str
    type_name: str
    server: Literal["plc", "ros"]
    why: str


@dataclass(frozen=True)
class Found:
    """What was found: topics by name, services and actions without those that each node has.

    ``where`` is what was looked at, in words; ``ros`` the keys of the configuration's section ``ros`` that
    lead there, ``why`` remarks on them by key; ``notes`` what is worth knowing beyond.
    """

    topics: Mapping[str, Topic]
    where: str
    ros: Mapping[str, object]
    why: Mapping[str, str] = field(default_factory=dict)
    notes: tuple[str, ...] = ()
    calls: tuple[Call, ...] = ()
