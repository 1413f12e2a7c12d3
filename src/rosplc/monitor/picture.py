"""What a look at the machine's channels returns: plain, frozen data."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import Any

from rosplc.levels import Level
from rosplc.monitor.states import ALL_WELL, State

__all__ = ["BridgeView", "ChannelView", "Event", "Picture", "ReaderView"]


@dataclass(frozen=True, slots=True)
class ReaderView:
    """A claimed reader line.

    Attributes:
        index: 0 to 3; line 0 of a channel towards ROS is the bridge's.
        task: Its name, as the reader gave it.
        pid: Its process, as the reader gave it; for people.
        alive: Whether it beats; None before that can be known.
        taken: Sequence of the newest message that it has taken.
        lost: Messages that it has missed. A reader that takes the newest alone misses by design.
        retries: Copies that it threw away because the writer came too near.
        error: Its last error number, 0 for none.
    """

    index: int
    task: str
    pid: int
    alive: bool | None
    taken: int
    lost: int
    retries: int
    error: int


@dataclass(frozen=True, slots=True)
class ChannelView:
    """One channel as it stands. Text comes from the object, and may hold any character.

    Attributes:
        id: The object's name, unique on the machine; ``classic:`` and the memory's name for a classic topic.
        prefix: The bridge's ``prefix:``.
        topic: As ROS writes it; the object's name where that cannot be known.
        direction: ``to_plc`` or ``to_ros``; empty if it cannot be known.
        type_name: ``package/msg/Name``; empty if it cannot be known.
        bridge: The bridge's name.
        bridge_pid: Its process, as it wrote it; 0 if there is none.
        state: How it stands, in a word.
        words: The same in a sentence, without time or numbers that change at each look.
        code: The error's code where there is one.
        rate_hz: Messages per second over the last seconds; None before it can be known.
        age_ns: Time since the newest message came; None before the first. It is exact once a message came
            while looking; before, it is taken from the message's stamp, and is at least the time of looking.
        received: Sequence of the newest message: how many there were since the object was made. For a
            classic topic, which has none, the changes that were seen.
        lost: Messages that the readers have missed, the reader that missed most counting. Readers that take
            the newest alone miss by design.
        refused: Messages that the writer could not put into a record.
        truncated: Messages with something cut off.
        writer_alive: Whether the writer beats: the bridge towards the PLC, the PLC towards ROS. None if it
            cannot be known, or not yet.
        reader_alive: Whether one of the readers beats: a PLC task towards the PLC, the bridge towards ROS.
        bridge_alive: That one of the two which is the bridge.
        plc_alive: That one of the two which is the PLC.
        plc_claimed: Whether the PLC's side holds a claim: alive, or dead without having given it back.
        ros_peers: ROS publishers towards the PLC, subscribers towards ROS; None if nobody counts them.
        stale: Whether the newest message is older than ``stale_after_ns``.
        silent: The same, half a second later and half a second longer: one late message changes nothing.
        stale_after_ns: How old it may become; 0 for never.
        configured: Whether a configuration said so; otherwise it is the default.
        record_size: Bytes of a record.
        slots: Slots of the object: the channel's depth.
        object_size: Bytes of the object.
        layout_id: 16 hexadecimal digits.
        generation: Drawn anew with each object.
        created_ns: When the object was made, ns since 1970 UTC.
        readers: The claimed reader lines.
        classic: Whether it is a classic topic's memory.
    """

    id: str
    prefix: str
    topic: str
    direction: str = ""
    type_name: str = ""
    bridge: str = ""
    bridge_pid: int = 0
    state: State = State.UNKNOWN
    words: str = ""
    code: str = ""
    rate_hz: float | None = None
    age_ns: int | None = None
    received: int = 0
    lost: int = 0
    refused: int = 0
    truncated: int = 0
    writer_alive: bool | None = None
    reader_alive: bool | None = None
    bridge_alive: bool | None = None
    plc_alive: bool | None = None
    plc_claimed: bool = False
    ros_peers: int | None = None
    stale: bool = False
    silent: bool = False
    stale_after_ns: int = 0
    configured: bool = False
    record_size: int = 0
    slots: int = 0
    object_size: int = 0
    layout_id: str = ""
    generation: int = 0
    created_ns: int = 0
    readers: tuple[ReaderView, ...] = ()
    classic: bool = False

    def as_json(self) -> dict[str, Any]:
        """Return plain data; ``state`` as its word, with its ``level`` and ``severity``."""
        members = {name: getattr(self, name) for name in self.__slots__}
        members["state"] = self.state.value
        members["level"] = self.state.level.name
        members["severity"] = self.state.severity
        members["readers"] = [dataclasses.asdict(reader) for reader in self.readers]
        return members


@dataclass(frozen=True, slots=True)
class BridgeView:
    """One bridge as its channels show it.

    Attributes:
        prefix: Its ``prefix:``.
        name: Its name.
        pid: Its process, as it wrote it; 0 if it has ended.
        alive: Whether it beats; None before that can be known.
        process: How its process stands, in words, if it does not beat; empty otherwise.
        channels: How many channels it has.
        worst: The worst state among them.
    """

    prefix: str
    name: str
    pid: int
    alive: bool | None
    channels: int
    worst: State
    process: str = ""

    def as_json(self) -> dict[str, Any]:
        """Return plain data."""
        members = {name: getattr(self, name) for name in self.__slots__}
        members["worst"] = self.worst.value
        return members


@dataclass(frozen=True, slots=True)
class Event:
    """Something that happened between two looks.

    Attributes:
        time_ns: When it was seen, ns since 1970 UTC.
        kind: ``appeared``, ``vanished``, ``replaced``, ``unreadable``, ``readable``, ``stale``,
            ``recovered``, ``refused``, ``lost``, ``truncated``, ``bridge-gone``, ``bridge-back``,
            ``plc-gone``, ``plc-back``.
        level: How grave it is; OK for what is no trouble, or its end.
        channel: The channel's id; empty where it concerns a whole bridge.
        prefix: The bridge's prefix.
        topic: The topic; empty where it concerns a whole bridge.
        words: What happened, as a sentence.
    """

    time_ns: int
    kind: str
    level: Level
    channel: str
    prefix: str
    topic: str
    words: str

    def as_json(self) -> dict[str, Any]:
        """Return plain data."""
        return {name: getattr(self, name) for name in self.__slots__} | {"level": self.level.name}


@dataclass(frozen=True, slots=True)
class Picture:
    """The machine's channels at one moment.

    Attributes:
        time_ns: When, ns since 1970 UTC.
        channels: Sorted by prefix, topic and id.
        bridges: Sorted by prefix and name.
        events: What happened since the look before.
        notes: What keeps the picture from being complete.
    """

    time_ns: int
    channels: tuple[ChannelView, ...]
    bridges: tuple[BridgeView, ...] = ()
    events: tuple[Event, ...] = ()
    notes: tuple[str, ...] = ()

    @property
    def worst(self) -> State:
        """The worst state among the channels; ``ok`` if there are none, which JSON gives as null."""
        return max((each.state for each in self.channels), key=lambda state: state.severity, default=State.OK)

    @property
    def wrong(self) -> tuple[ChannelView, ...]:
        """The channels with which something is wrong, the worst first."""
        found = (each for each in self.channels if each.state not in ALL_WELL)
        return tuple(sorted(found, key=lambda each: -each.state.severity))

    def channel(self, identifier: str) -> ChannelView | None:
        """Return the channel with an id; None if there is none any more."""
        return next((each for each in self.channels if each.id == identifier), None)

    def as_json(self) -> dict[str, Any]:
        """Return plain data."""
        return {
            "time_ns": self.time_ns,
            "worst": self.worst.value if self.channels else None,
            "channels": [each.as_json() for each in self.channels],
            "bridges": [each.as_json() for each in self.bridges],
            "events": [each.as_json() for each in self.events],
            "notes": list(self.notes),
        }
