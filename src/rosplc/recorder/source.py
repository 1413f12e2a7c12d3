"""Sources for a replay: our own recordings, those of rosbag2, and ROS 1 bags, in order of time."""

from __future__ import annotations

import heapq
import json
from abc import ABC, abstractmethod
from collections.abc import Collection, Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from rosplc.errors import RecordingError, RosplcError
from rosplc.model import DISTROS, TypeStore
from rosplc.recorder.carried import action_of, recorded_name, service_of, with_interface
from rosplc.recorder.mcap_file import Channel, Message, Part, Schema, Survey, read_part, survey
from rosplc.recorder.store import qos_of_text
from rosplc.ros import DEFAULT, ROS1, Qos
from rosplc.ros.bag import Bag
from rosplc.ros.plain_file import unreadable_kind

_OPEN_PARTS = 64
"""Maximum number of chunks that overlap in time and are sorted; beyond it, order is lost, not memory."""


@dataclass(frozen=True)
class SourceTopic:
    """A topic of a recording."""

    name: str
    type_name: str  # ``package/msg/Name``
    # the ``.msg`` text with every type that it needs; None if the distribution has it
    definition: str | None = None
    count: int = 0  # messages
    qos: Qos = DEFAULT  # what its publisher offered
    direction: str = ""  # ``to_plc`` or ``to_ros`` if a bridge's channel was recorded; else empty
    # the channel's limits, as a self-description has them; None if there was no channel
    limits: Mapping[str, Any] | None = None
    slots: int = 0  # the channel's slots; 0 if there was none
    distro: str = ""  # the distribution that its definition comes from; empty if unknown
    ros1: bool = False  # whether its messages are in ROS 1's serialization; else in CDR
    type_hash: str = ""  # what the recording gives as its type's hash; empty if it does not

    @property
    def service(self) -> str:
        """The service whose events the topic contains, or empty."""
        return service_of(self.name, self.type_name)

    @property
    def action(self) -> str:
        """The action whose goals the topic contains, or empty."""
        return action_of(self.name, self.type_name)

    @property
    def call_type(self) -> str:
        """The type of that service or action."""
        return self.type_name.removesuffix("_SendGoal_Event" if self.action else "_Event")

    def types(self, distro: str = "jazzy") -> TypeStore:
        """Return a store with the topic's type, as it was recorded.

        ``distro`` is the source of types if the recording has neither definition nor distribution. Raises
        RecordingError REC007 if there is no definition, or it cannot be used.
        """
        try:
            if self.definition is not None:
                defined = self.call_type if self.action else self.type_name
                store = TypeStore.from_definition(defined, self.definition, distro=self.distro or distro)
                if not (self.service or self.action):
                    return store
                # Events are messages of ROS 2, also those of a call in ROS 1.
                types = {name: store[name] for name in store.names()}
                return with_interface(TypeStore("", types), self.call_type)
            store = TypeStore.bundled(self.distro or distro)
            same = self.type_hash in ("", store.type_hash(self.type_name))
        except RosplcError as error:
            raise RecordingError(
                "REC007", f"the type cannot be used: {error.what} [{error.code}]", where=self.name
            ) from error
        if not same:
            what = f"its definition differs from that of {store.distro} and is not in the recording"
            raise RecordingError("REC007", what, where=self.name)
        return store


@dataclass(frozen=True, slots=True)
class SourceMessage:
    """A message: the times of recording and of sending (ns since 1970), and its bytes."""

    topic: str
    log_ns: int
    publish_ns: int
    data: bytes


class Source(ABC):
    """An open recording."""

    start_ns = end_ns = 0
    notes: tuple[str, ...] = ()  # remarks on the file as a whole

    def __init__(self) -> None:
        self.topics: dict[str, SourceTopic] = {}
        self.unusable: dict[str, str] = {}  # topic → why it cannot be replayed

    @abstractmethod
    def messages(self, topics: Collection[str], start_ns: int, end_ns: int) -> Iterator[SourceMessage]:
        """Yield the messages with start_ns ≤ log time ≤ end_ns, in time order; REC003 where damage begins."""

    def close(self) -> None:  # noqa: B027
        """Close the file, if it stays open between reads."""


def open_source(path: Path, distro: str = "jazzy") -> Source:
    """Open an ``.mcap`` or ``.bag`` file, or the folder of a ROS 2 recording.

    ``distro`` is the source of types if the file has neither definitions nor a distribution. Raises
    RecordingError REC003 if an MCAP file cannot be read, BackendError ROS006 for other kinds of recordings.
    """
    what, remedy = unreadable_kind(path)
    if what:
        raise RecordingError("REC003", what, where=str(path), remedy=remedy)
    files = sorted(path.glob("*.mcap")) if path.is_dir() else [path]
    if not files or (not path.is_dir() and path.suffix in (".bag", ".db3")):
        return _BagSource(path, distro)
    return McapSource(files)


class McapSource(Source):
    """One MCAP file, or the files of a folder together."""

    def __init__(self, files: list[Path]) -> None:
        super().__init__()
        self._surveys = [survey(file) for file in files]
        self._names = [self._add(found) for found in self._surveys]
        parts = [part for found in self._surveys for part in found.parts]
        self.start_ns = min((part.start_ns for part in parts), default=0)
        self.end_ns = max((part.end_ns for part in parts), default=0)
        self.notes = tuple(
            f"{found.path}: {found.problem}; only the intact messages are replayed"
            for found in self._surveys
            if not found.complete or found.damaged
        )

    def messages(self, topics: Collection[str], start_ns: int, end_ns: int) -> Iterator[SourceMessage]:
        """Yield messages; chunks that overlap in time are read together."""
        waiting = [
            (part.start_ns, number, part.offset, part)
            for number, found in enumerate(self._surveys)
            for part in found.parts
            if part.end_ns >= start_ns and part.start_ns <= end_ns
        ]
        waiting.sort(reverse=True)  # the next one last
        heap: list[tuple[int, int, int, Message, Iterator[Message]]] = []
        while heap or waiting:
            if waiting and (not heap or (waiting[-1][0] <= heap[0][0] and len(heap) < _OPEN_PARTS)):
                _, number, offset, part = waiting.pop()
                run = self._run(number, part, topics, start_ns, end_ns)
            else:
                _, number, offset, one, run = heapq.heappop(heap)
                name = self._names[number][one.channel_id]
                yield SourceMessage(name, one.log_time, one.publish_time, one.data)
            if (following := next(run, None)) is not None:  # equal times in the order of the file
                heapq.heappush(heap, (following.log_time, number, offset, following, run))

    def _run(
        self, number: int, part: Part, topics: Collection[str], start_ns: int, end_ns: int
    ) -> Iterator[Message]:
        """Yield the selected messages of one part in time order; equal times keep the file's order."""
        wanted = {channel for channel, name in self._names[number].items() if name in topics}
        messages = [
            one
            for one in read_part(self._surveys[number].path, part)
            if one.channel_id in wanted and start_ns <= one.log_time <= end_ns
        ]
        messages.sort(key=lambda one: one.log_time)
        messages.reverse()
        while messages:  # from the end, so that what was given is let go of
            yield messages.pop()

    def _add(self, found: Survey) -> dict[int, str]:
        """Note a file's topics; return channel id → topic for those that can be replayed."""
        names = {}
        for number, channel in found.channels.items():
            name, schema = channel.topic, found.schemas.get(channel.schema_id)
            events = recorded_name(name) != name
            if (
                channel.message_encoding != "cdr"
                or schema is None
                or (schema.encoding != "ros2msg" and not events)
            ):
                encoding = "none" if schema is None else schema.encoding or "none"
                self.unusable[name] = (
                    f"its messages are encoded as {channel.message_encoding or 'none'}, its schema as "
                    f"{encoding}; cdr and ros2msg are required"
                )
                continue
            topic = _topic(channel, schema, found.counts[number])
            known = self.topics.get(name)
            if known is not None:
                if (known.type_name, known.definition) != (topic.type_name, topic.definition):
                    self.unusable[name] = "it was recorded with two different definitions"
                    continue
                topic = replace(topic, count=known.count + topic.count)
            self.topics[name] = topic
            names[number] = name
        return names


def _topic(channel: Channel, schema: Schema, count: int) -> SourceTopic:
    metadata = channel.metadata
    direction = metadata.get("rosplc.direction", "")
    limits, slots = None, 0
    with suppress(KeyError, ValueError, RecursionError):
        if direction:
            found, slots = json.loads(metadata["rosplc.limits"]), int(metadata["rosplc.slots"])
            limits = found if isinstance(found, dict) else None
    return SourceTopic(
        name=channel.topic,
        type_name=schema.name,
        # Whatever a writer takes for a service's schema, no two agree on it.
        definition=metadata.get("rosplc.definition")
        if schema.encoding != "ros2msg" or schema.name.endswith("_Event")
        else schema.data.decode("utf-8", "replace"),
        count=count,
        qos=qos_of_text(metadata.get("offered_qos_profiles", "")),
        direction=direction if direction in ("to_plc", "to_ros") else "",
        limits=limits,
        slots=slots if 4 <= slots <= 65536 and slots & (slots - 1) == 0 else 0,
        distro=metadata.get("rosplc.distro", ""),
        type_hash=metadata.get("topic_type_hash", ""),
    )


class _BagSource(Source):
    """A recording read by rosbags: a ROS 1 bag, or rosbag2's SQLite format."""

    def __init__(self, path: Path, distro: str) -> None:
        super().__init__()
        self._bag = Bag(path)
        self.start_ns, self.end_ns = self._bag.span()
        self._names: dict[str, str] = {}
        ros1 = self._bag.ros_version == 1
        distro = self._bag.distro if self._bag.distro in DISTROS else distro
        # Without definitions, those of a ROS 2 distribution hold for a ROS 2 recording.
        known = TypeStore.bundled("jazzy" if distro == ROS1 and not ros1 else distro)
        if any(not topic.definition for topic in self._bag.topics()):
            self.notes = (
                f"{path}: types without a recorded definition are taken from {known.distro} (--distro)",
            )
        for topic in self._bag.topics():
            # ROS 1 records a relative name as the node wrote it.
            name = topic.name if topic.name.startswith("/") else f"/{topic.name}"
            before = self.topics.get(name)
            new = SourceTopic(
                name,
                topic.type_name,
                definition=topic.definition or None,
                count=topic.count + (before.count if before else 0),
                distro=known.distro,
                ros1=ros1,
            )
            self.topics[name] = new
            self._names[topic.name] = name
            if topic.several or (before and replace(before, count=new.count) != new):
                self.unusable[name] = "it was recorded with two different types or definitions"
            elif not topic.definition and topic.type_name not in known:
                self.unusable[name] = (
                    f"neither the file nor {known.distro} contains a definition of {topic.type_name} "
                    "(select another distribution with --distro)"
                )

    def messages(self, topics: Collection[str], start_ns: int, end_ns: int) -> Iterator[SourceMessage]:
        """Yield the messages of these topics."""
        wanted = [recorded for recorded, name in self._names.items() if name in topics]
        for recorded, _, time_ns, data in self._bag.messages(wanted):
            if start_ns <= time_ns <= end_ns:
                yield SourceMessage(self._names[recorded], time_ns, time_ns, data)

    def close(self) -> None:
        """Close the file."""
        self._bag.close()
