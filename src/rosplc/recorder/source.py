"""What can be replayed: our own recordings, those of rosbag2, and ROS 1 bags, all as CDR in order of time."""

from __future__ import annotations

import heapq
import json
from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Protocol

from rosplc.errors import RecordingError
from rosplc.recorder.mcap_read import FileMessage, Part, Survey, read_part, survey
from rosplc.recorder.rosbag2 import qos_of_text
from rosplc.ros import DEFAULT, Qos
from rosplc.ros.plain_file import unreadable_kind

__all__ = ["McapSource", "Source", "SourceMessage", "SourceTopic", "open_source"]

_OPEN_PARTS = 64
"""Chunks that overlap in time and are put in order; a file made to hold more costs order, not memory."""


@dataclass(frozen=True)
class SourceTopic:
    """A topic of a recording.

    Attributes:
        name: The topic.
        type_name: ``package/msg/Name``.
        definition: The ``.msg`` text with every type that it needs; None if the distribution has it.
        count: Messages.
        qos: What its publisher offered.
        direction: ``to_plc`` or ``to_ros`` if a bridge's channel was recorded; else empty.
        limits: The channel's limits, as a self-description has them; None if there was no channel.
        slots: The channel's slots; 0 if there was none.
        distro: The distribution that its definition comes from; empty if unknown.
        notes: What was mapped or dropped on the way, in words.
    """

    name: str
    type_name: str
    definition: str | None = None
    count: int = 0
    qos: Qos = DEFAULT
    direction: str = ""
    limits: Mapping[str, Any] | None = None
    slots: int = 0
    distro: str = ""
    notes: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class SourceMessage:
    """A message: when it was recorded and when its source sent it (ns since 1970), and its CDR."""

    topic: str
    log_ns: int
    publish_ns: int
    data: bytes


class Source(Protocol):
    """A recording that is open."""

    topics: dict[str, SourceTopic]
    unusable: dict[str, str]
    """Topic → why it cannot be replayed."""
    notes: tuple[str, ...]
    """What is to be said of the file as a whole."""
    start_ns: int
    end_ns: int

    def messages(self, topics: Collection[str], start_ns: int, end_ns: int) -> Iterator[SourceMessage]:
        """Yield the messages of these topics with start_ns ≤ log time ≤ end_ns, in order of log time."""

    def close(self) -> None:
        """Close the file."""


def open_source(path: Path, distro: str = "jazzy") -> Source:
    """Open a recording.

    Args:
        path: An ``.mcap`` or ``.bag`` file, or the folder of a ROS 2 recording.
        distro: Into whose types a ROS 1 recording is translated.

    Raises:
        RecordingError: REC003, it cannot be read.
        BackendError: ROS006, the same for a recording of another kind than MCAP.
    """
    what, remedy = unreadable_kind(path)
    if what:
        raise RecordingError("REC003", what, where=str(path), remedy=remedy)
    files = sorted(path.glob("*.mcap")) if path.is_dir() else [path]
    if path.is_dir() and not files:
        return _BagSource(path, distro)
    if not path.is_dir() and path.suffix in (".bag", ".db3"):
        return _BagSource(path, distro)
    return McapSource(files)


class McapSource:
    """One MCAP file, or the files of a folder together."""

    def __init__(self, files: list[Path]) -> None:
        self._surveys = [survey(file) for file in files]
        self.topics: dict[str, SourceTopic] = {}
        self.unusable: dict[str, str] = {}
        self._names: list[dict[int, str]] = []
        for found in self._surveys:
            self._names.append(self._add(found))
        parts = [part for found in self._surveys for part in found.parts]
        self.start_ns = min((part.start_ns for part in parts), default=0)
        self.end_ns = max((part.end_ns for part in parts), default=0)
        self.notes = tuple(
            f"{found.path}: {found.problem}; what lies before is replayed"
            for found in self._surveys
            if not found.complete or found.damaged
        )

    def close(self) -> None:
        """Nothing is open between two reads."""

    def messages(self, topics: Collection[str], start_ns: int, end_ns: int) -> Iterator[SourceMessage]:
        """Yield the messages of these topics, in order of log time.

        Raises:
            RecordingError: REC003, the file is damaged; before that, everything up to there was given.
        """
        waiting = sorted(
            (
                (part.start_ns, number, part)
                for number, found in enumerate(self._surveys)
                for part in found.parts
                if part.end_ns >= start_ns and part.start_ns <= end_ns
            ),
            key=lambda entry: entry[0],
        )
        heap: list[tuple[int, int, int, _Run]] = []
        at = 0
        while heap or at < len(waiting):
            while at < len(waiting) and (
                not heap or (waiting[at][0] <= heap[0][0] and len(heap) < _OPEN_PARTS)
            ):
                _, number, part = waiting[at]
                run = self._run(number, part, topics, start_ns, end_ns)
                if run is not None:  # equal times in the order of the file
                    heapq.heappush(heap, (run.time_ns, number, part.offset, run))
                at += 1
            if not heap:
                return
            _, number, offset, run = heapq.heappop(heap)
            yield run.take()
            if run:
                heapq.heappush(heap, (run.time_ns, number, offset, run))

    def _run(
        self, number: int, part: Part, topics: Collection[str], start_ns: int, end_ns: int
    ) -> _Run | None:
        names = {channel: name for channel, name in self._names[number].items() if name in topics}
        messages = [
            one
            for one in read_part(self._surveys[number].path, part)
            if one.channel in names and start_ns <= one.log_ns <= end_ns
        ]
        return _Run(messages, names) if messages else None

    def _add(self, found: Survey) -> dict[int, str]:
        """Note a file's topics; return channel id → topic of those that can be replayed."""
        names = {}
        for number, channel in found.channels.items():
            schema = found.schemas.get(channel.schema_id)
            if channel.message_encoding != "cdr" or schema is None or schema.encoding != "ros2msg":
                encoding = "none" if schema is None else schema.encoding or "none"
                self.unusable[channel.topic] = (
                    f"its messages are {channel.message_encoding or 'of no known encoding'} with a schema of "
                    f"{encoding}; cdr with ros2msg is needed"
                )
                continue
            topic = _topic(
                channel.topic, schema.name, schema.data, channel.metadata, found.counts.get(number, 0)
            )
            known = self.topics.get(channel.topic)
            if known is not None:
                if (known.type_name, known.definition) != (topic.type_name, topic.definition):
                    self.unusable[channel.topic] = "it was recorded with two different definitions"
                    continue
                topic = replace(topic, count=known.count + topic.count)
            self.topics[channel.topic] = topic
            names[number] = channel.topic
        return names


class _Run:
    """The messages of one part, not yet given."""

    def __init__(self, messages: list[FileMessage], names: Mapping[int, str]) -> None:
        # Equal times stay in the order of the file; the last is the next: a list gives up its end cheaply.
        messages.sort(key=lambda one: one.log_ns)
        messages.reverse()
        self._messages, self._names = messages, names

    def __bool__(self) -> bool:
        return bool(self._messages)

    @property
    def time_ns(self) -> int:
        return self._messages[-1].log_ns

    def take(self) -> SourceMessage:
        one = self._messages.pop()
        return SourceMessage(self._names[one.channel], one.log_ns, one.publish_ns, one.data)


@dataclass
class _BagSource:
    """A recording that rosbags reads: ROS 1 bags, and rosbag2's SQLite."""

    path: Path
    distro: str
    topics: dict[str, SourceTopic] = field(default_factory=dict)
    unusable: dict[str, str] = field(default_factory=dict)
    notes: tuple[str, ...] = ()
    start_ns: int = 0
    end_ns: int = 2**63 - 1

    def __post_init__(self) -> None:
        from rosplc.ros.recording import Recording

        self._recording = Recording(self.path, self.distro)
        for name, topic in self._recording.topics.items():
            self.topics[name] = SourceTopic(
                name,
                topic.type_name,
                definition=None if topic.bundled else self._recording.definition(name),
                count=topic.count,
                distro=self.distro,
                notes=topic.notes,
            )
        self.start_ns, self.end_ns = self._recording.start_ns, self._recording.end_ns

    def messages(self, topics: Collection[str], start_ns: int, end_ns: int) -> Iterator[SourceMessage]:
        """Yield the messages of these topics."""
        for one in self._recording.messages(topics):
            if start_ns <= one.time_ns <= end_ns:
                yield SourceMessage(one.topic, one.time_ns, one.time_ns, one.cdr)

    def close(self) -> None:
        """Close the file."""
        self._recording.close()


def _topic(name: str, type_name: str, schema: bytes, metadata: Mapping[str, str], count: int) -> SourceTopic:
    direction = metadata.get("rosplc.direction", "")
    limits, slots = None, 0
    try:
        if direction:
            found = json.loads(metadata["rosplc.limits"])
            limits, slots = (found if isinstance(found, dict) else None), int(metadata["rosplc.slots"])
    except (KeyError, ValueError, RecursionError):
        limits, slots = None, 0
    return SourceTopic(
        name=name,
        type_name=type_name,
        definition=schema.decode("utf-8", "replace"),
        count=count,
        qos=qos_of_text(metadata.get("offered_qos_profiles", "")),
        direction=direction if direction in ("to_plc", "to_ros") else "",
        limits=limits,
        slots=slots if 4 <= slots <= 65536 and slots & (slots - 1) == 0 else 0,
        distro=metadata.get("rosplc.distro", ""),
    )
