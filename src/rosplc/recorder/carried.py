"""Which topics are recorded, what they are called in a file, and how their channels are read in order."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from fnmatch import fnmatchcase
from pathlib import Path

from rosplc.codec import Codec, Wire
from rosplc.described import layout_of
from rosplc.monitor.objects import open_object
from rosplc.recorder.mcap_write import ChannelInfo
from rosplc.recorder.rosbag2 import qos_text
from rosplc.ros import DEFAULT, LATCHED, Qos
from rosplc.shm import Description, Direction, Reader, distance
from rosplc.shm.constants import WRITER_LINE

__all__ = ["CarriedChannel", "Selection", "channel_info"]


@dataclass(frozen=True)
class Selection:
    """What is taken and what is left out.

    Attributes:
        topics: Names or patterns such as ``/robot1/*``; empty for all. A ``*`` also matches slashes.
        exclude: Names or patterns that are left out all the same.
    """

    topics: tuple[str, ...] = ()
    exclude: tuple[str, ...] = ()

    def __contains__(self, topic: str) -> bool:
        """Return whether a topic is meant."""
        if any(fnmatchcase(topic, _absolute(one)) for one in self.exclude):
            return False
        return not self.topics or any(fnmatchcase(topic, _absolute(one)) for one in self.topics)

    def without_match(self, topics: Iterable[str]) -> list[str]:
        """Return what was asked for and matches none of these topics."""
        names = list(topics)
        return [one for one in self.topics if not any(fnmatchcase(name, _absolute(one)) for name in names)]


def _absolute(pattern: str) -> str:
    return pattern if pattern.startswith(("/", "*")) else f"/{pattern}"


_NO_COUNT = 1 << 24
"""A distance beyond this is that to a head which somebody scribbled."""


class CarriedChannel:
    """An object, attached read-only: nobody notices that it is recorded.

    Args:
        path: The object's file.
        since_ns: When the recording began (ns since 1970), if it has: then what the object holds already is
            taken. None: what comes after :meth:`begin` is.

    Attributes:
        topic: As its description says.
        description: Its self-description.
        slots: Its slots; one message less can wait.
        codec: Record to CDR.
        reader: Takes every message in order, and counts what it missed.
        since_creation: Whether the object was made while recording, so that its first message is one to take.

    Raises:
        ChannelError: As :func:`rosplc.shm.attach`; SHM113 if it does not describe itself.
    """

    def __init__(self, path: Path, *, since_ns: int | None) -> None:
        self._attached = open_object(str(path))
        try:
            self.description: Description = self._attached.description
            layout = layout_of(self._attached)
            # Also of a ROS 1 channel: its store is one of ROS 2, as the description gives no version.
            self.codec = Codec(layout, Wire.CDR)
            self.reader: Reader = self._attached.reader(latched=since_ns is not None)
            self._begun = since_ns is not None
        except BaseException:
            self._attached.close()
            raise
        self.topic = self.description.topic
        self.since_creation = since_ns is not None and self._attached.identity.created_ns >= since_ns
        self.slots = self._attached.identity.slot_count

    def begin(self) -> Reader:
        """Return the reader, which takes what comes from now on; what came while it was opened is no loss.

        Raises:
            ChannelError: SHM111, the object has been retired meanwhile.
        """
        if not self._begun:
            self._begun = True
            self.reader = self._attached.reader()
        return self.reader

    def still_there(self) -> bool:
        """Return whether the name still leads to this object."""
        return self._attached.still_there()

    def untaken(self) -> int:
        """Return how many messages the object holds that the reader has not taken."""
        head = self._attached.region.word(WRITER_LINE["head"])
        if not head or not (self.reader.last or self.since_creation):
            return 0
        count = distance(self.reader.last, head, self.slots)
        return count if count < _NO_COUNT else 0

    def close(self) -> None:
        """Let go of the object."""
        self._attached.close()


def channel_info(carried: CarriedChannel, number: int, prefix: str, qos: Qos | None) -> ChannelInfo:
    """Return how a file names a channel; ``qos`` None where no configuration says it."""
    description, layout = carried.description, carried.codec.layout
    return ChannelInfo(
        id=number,
        topic=description.topic,
        schema_name=layout.type_name,
        schema_encoding="ros2msg",
        schema=layout.store.definition_text(layout.type_name).encode(),
        encoding="cdr",
        metadata={
            "offered_qos_profiles": qos_text(qos or _usual(description)),
            "topic_type_hash": layout.store.type_hash(layout.type_name),
            **_own(description, carried.slots, prefix),
        },
    )


def _usual(description: Description) -> Qos:
    # Which QoS the bridge uses stands in its configuration alone; these are its defaults.
    if description.direction is Direction.TO_ROS:
        return LATCHED
    return DEFAULT


def _own(description: Description, slots: int, prefix: str) -> Mapping[str, str]:
    """Return what a replay needs to make the same channel again."""
    return {
        "rosplc.direction": description.direction.word,
        "rosplc.limits": json.dumps(dict(description.limits)),
        "rosplc.layout_id": description.layout_id,
        "rosplc.slots": str(slots),
        "rosplc.distro": description.distro,
        "rosplc.bridge": description.bridge,
        "rosplc.prefix": prefix,
    }
