"""What a look at the machine's channels returns, as frozen data and as text, and what happened between two.

The states' words and levels are those of ``/diagnostics``. A bridge knows its topics and reports more; a look
reads the objects, which remain when the bridge is dead.
"""

from __future__ import annotations

import dataclasses
import enum
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from typing import Any

from rosplc.harmless import plural
from rosplc.levels import Level, format_age


class State(enum.Enum):
    """The state of a channel, the worst first. The value is the word for people and for JSON."""

    UNREADABLE = "unreadable"
    """The object cannot be used: damaged, closed to this user, no object of this format."""
    MISSING = "missing"  # the configuration names the topic, and there is no object
    DEAD = "dead"  # bridge or PLC hold a claim, and do not beat any more: killed, stopped, or stuck
    NO_BRIDGE = "no bridge"  # the bridge ended in order, and left the last message
    REFUSED = "refused"  # messages did not fit and were refused, within the last ten seconds
    LOST = "lost"  # messages of a topic on which each one counts were lost, within the last ten seconds
    STALE = "stale"  # the last message is older than the topic allows
    SILENT = "silent"  # no message came yet, for longer than the topic allows
    NO_PLC = "no PLC"  # no PLC task reads it, or writes it
    NO_SERVER = "no server"  # the PLC calls a service or action of ROS, and no server is ready
    UNKNOWN = "looking"  # looked at for too short a time to say who is alive; or the bridge is starting
    OK = "ok"  # nothing is wrong; perhaps nobody publishes, where that is allowed

    @property
    def severity(self) -> int:
        """0 for ``ok``, more for what is worse."""
        return _SEVERITY[self]

    @property
    def level(self) -> Level:
        """The level that ``/diagnostics`` gives it."""
        return _LEVELS.get(self, Level.WARN)


_SEVERITY = {state: number for number, state in enumerate(reversed(State))}
_LEVELS = {
    **dict.fromkeys((State.UNREADABLE, State.MISSING, State.DEAD), Level.ERROR),
    **dict.fromkeys((State.STALE, State.SILENT), Level.STALE),
    **dict.fromkeys((State.OK, State.UNKNOWN), Level.OK),
}
ALL_WELL = (State.OK, State.UNKNOWN)  # the states in which nothing is wrong
ASKS = ("request", "goal")  # the parts of services and actions that the caller writes


@dataclass(frozen=True, slots=True)
class ReaderView:
    """A claimed reader line; line 0 of a channel towards ROS is the bridge's.

    ``task`` and ``pid`` are what the reader gave, for people; ``alive`` is None before that can be known.
    ``taken`` is the sequence of the newest message taken; ``lost`` counts messages missed, which a reader
    that takes the newest alone does by design, ``retries`` copies thrown away because the writer came too
    near; ``error`` is its last error number, 0 for none.
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
class CallView:
    """What an object of a service or action tells of calls, which ``server`` (plc or ros) carries out.

    ``number`` is the newest message's call, counted since its caller started, 0 before the first message;
    ``correlation`` the same, unique over all lives of the caller: 16 hexadecimal digits. ``status`` is the
    newest message's status in words, with the reason. ``open``: the newest call has not ended; None where
    that cannot be known. ``ended`` are the calls that were seen to end, by outcome and reason in words, in
    the object of the answers; the first look counts those that the object still has.
    """

    server: str
    number: int = 0
    correlation: str = ""
    status: str = ""
    open: bool | None = None
    ended: dict[str, int] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class ChannelView:
    """One channel at one moment. Text comes from the object, and may hold any character.

    ``id`` is the object's name, unique on the machine, or ``classic:`` and the memory's name; ``topic`` as
    ROS writes it, of a service or action its name, and the object's name where that cannot be known; ``kind``
    is ``topic``, ``service`` or ``action``, ``part`` ``topic`` or what a service's or action's object
    carries, ``client`` the name of one of several uses, ``call`` None for a topic and where it cannot be
    known. ``direction`` (``to_plc`` or ``to_ros``) and ``type_name`` are empty if they cannot be known.

    ``words`` is the state in a sentence, without time or numbers that change at each look; ``code`` the
    error's code where there is one. ``rate_hz`` counts the last seconds, None before it can be known.
    ``age_ns`` is None before the first message, and exact once one came while looking; before, it is taken
    from the message's stamp, and is at least the time of looking. ``received`` is the sequence of the newest
    message, for a classic topic, which has none, the changes that were seen; ``lost`` what the reader that
    missed most has missed (one that takes the newest alone misses by design); ``refused`` could not be put
    into a record, ``truncated`` had something cut off.

    ``writer_alive`` and ``reader_alive``, one of which is ``bridge_alive`` and the other ``plc_alive``, are
    None where that cannot be known, or not yet; ``plc_claimed``: the PLC's side holds a claim, alive, or dead
    without having given it back; ``bridge_pid`` is 0 if there is none. ``ros_peers`` are ROS publishers or
    subscribers, clients or servers; None if they are not counted. ``stale``: the newest message is older than
    ``stale_after_ns`` (0 for never), which is from a configuration if ``configured``, else the default;
    ``silent``: the same, half a second later and half a second longer, so that one late message changes
    nothing. ``generation`` is a random number, another for each object; ``created_ns`` when it was made, ns
    since 1970 UTC.
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
    kind: str = "topic"
    part: str = "topic"
    client: str = ""
    call: CallView | None = None

    @property
    def label(self) -> str:
        """What people call it: ``/cmd_vel``, ``/gripper/close request left``."""
        return self.topic if self.kind == "topic" else f"{self.topic} {self.part} {self.client}".rstrip()

    def as_json(self) -> dict[str, Any]:
        """Return plain data; ``state`` as its word, with its ``level`` and ``severity``."""
        members = {name: getattr(self, name) for name in self.__slots__}
        members["state"] = self.state.value
        members["level"] = self.state.level.name
        members["severity"] = self.state.severity
        members["readers"] = [dataclasses.asdict(reader) for reader in self.readers]
        members["label"] = self.label
        members["call"] = self.call and dataclasses.asdict(self.call)
        return members


@dataclass(frozen=True, slots=True)
class BridgeView:
    """One bridge as its channels show it.

    ``pid`` is its process, as it wrote it, 0 if it has ended; ``alive`` None before it can be known;
    ``process`` the state of its process in words, if it does not beat; ``worst`` the worst state among its
    channels.
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
        return dataclasses.asdict(self) | {"worst": self.worst.value}


@dataclass(frozen=True, slots=True)
class Event:
    """Something that happened between two looks, seen at ``time_ns`` since 1970 UTC.

    ``kind`` is ``appeared``, ``vanished``, ``replaced``, ``unreadable``, ``readable``, ``stale``,
    ``recovered``, ``refused``, ``lost``, ``truncated``, ``bridge-gone``, ``bridge-back``, ``plc-gone`` or
    ``plc-back``; ``level`` OK for what is no trouble, or its end; ``channel`` the channel's id, empty where
    it concerns a whole bridge, as is ``topic``; ``words`` a sentence.
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

    Channels are sorted by prefix, topic and id, bridges by prefix and name. ``events`` happened since the
    look before; ``notes`` are what keeps the picture from being complete.
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


def judge(
    seen: ChannelView, *, starting: bool = False, refused_lately: bool = False, lost_lately: bool = False
) -> tuple[State, str]:
    """Return how a channel is, in a word and a sentence; of several things the worst counts.

    ``starting``: the bridge has a claim, and is too young to be expected to beat. ``lost_lately``: messages
    were lost where each one counts.
    """
    to_plc = seen.direction == "to_plc"
    if seen.bridge_alive is False:
        if seen.bridge_pid:
            return State.DEAD, f"the heartbeat of the bridge (process {seen.bridge_pid}) has stopped"
        return State.NO_BRIDGE, "the bridge has stopped; its last message remains"
    if seen.plc_alive is False and seen.plc_claimed:
        if to_plc:
            tasks = ", ".join(reader.task or f"process {reader.pid}" for reader in seen.readers)
            return State.DEAD, f"the heartbeat of the PLC task that reads it has stopped: {tasks}"
        return State.DEAD, "the heartbeat of the PLC task that writes it has stopped"
    if starting:
        return (
            State.UNKNOWN,
            f"the bridge (process {seen.bridge_pid}) is starting and has sent no heartbeat yet",
        )
    if refused_lately:
        return State.REFUSED, "messages do not fit and are refused; the bridge's log shows why"
    if lost_lately:
        return State.LOST, "messages that should be read are lost; raise slots: or read more per scan"
    # Before silence, which begins with time: the same in the first second as in the tenth.
    if seen.plc_alive is False and not seen.received:
        return _no_plc(seen)
    if seen.silent:
        return (State.STALE if seen.received else State.SILENT), silence_words(seen)
    if seen.bridge_alive is None or (seen.plc_alive is None and seen.plc_claimed):
        return State.UNKNOWN, "waiting for a heartbeat"
    if seen.plc_alive is False:
        return _no_plc(seen)
    if seen.call is not None:
        if seen.ros_peers == 0 and seen.call.server == "ros" and seen.part in ASKS:
            return State.NO_SERVER, "no ROS server is ready"
        return State.OK, seen.call.status or "no call yet"
    if seen.ros_peers == 0:
        return State.OK, "no publisher" if to_plc else "no subscriber"
    if not seen.received:
        return State.OK, "no message yet"
    return State.OK, "messages arrive" if seen.rate_hz else "no message at present, which is allowed"


def _no_plc(seen: ChannelView) -> tuple[State, str]:
    if seen.call is not None:
        return State.NO_PLC, f"no PLC task {'serves' if seen.call.server == 'plc' else 'calls'} it"
    if seen.direction != "to_plc":
        return State.NO_PLC, "no PLC task writes it"
    nothing = "" if seen.received else f", and {silence_words(seen)}"
    return State.NO_PLC, f"no PLC task reads it{nothing}"


def silence_words(seen: ChannelView) -> str:
    """Return a sentence on a source that is silent, or was until a moment ago."""
    to_plc = seen.direction == "to_plc"
    source = "ROS" if to_plc else "the PLC"
    nobody = to_plc and seen.ros_peers == 0
    if not seen.received:
        return f"no message yet from {source}" + (": no publisher" if nobody else "")
    if not seen.stale:
        return f"messages from {source} have resumed after silence"
    gone = "; no publisher is left" if nobody else ""
    return f"no message from {source} for longer than allowed{gone}"


MARKS = {Level.OK: " ", Level.WARN: "!", Level.ERROR: "X", Level.STALE: "~"}
"""One character per level, for those who cannot tell colours, in any character set."""


def state_text(view: ChannelView) -> str:
    """Return mark and word of the state: ``X dead``."""
    return f"{MARKS[view.state.level]} {view.state.value}"


def rate_text(rate_hz: float | None) -> str:
    """Return a rate in Hz with three digits; ``-`` while it is not known."""
    if rate_hz is None:
        return "-"
    return f"{rate_hz:.0f}" if rate_hz >= 100 or rate_hz == 0 else f"{rate_hz:.3g}"


def age_text(age_ns: int | None) -> str:
    """Return an age: ``12 ms``, ``1.2 s``, ``14 s``, ``3 min``; ``never`` before the first message."""
    if age_ns is None:
        return "never"
    if age_ns < 100_000_000:
        return f"{age_ns // 1_000_000} ms"
    return format_age(age_ns)


def count_text(count: int) -> str:
    """Return a counter in at most five characters: ``99999``, ``12.3M``."""
    if count < 100_000:
        return str(count)
    for unit in "kMG":
        count_in = count / 1000
        if count_in < 999.5 or unit == "G":
            return f"{count_in:.0f}{unit}" if count_in >= 100 else f"{count_in:.3g}{unit}"
        count = round(count_in)
    raise AssertionError  # the loop returns


def plc_text(view: ChannelView) -> str:
    """Return how the PLC's side of a channel is: ``alive``, ``dead``, ``none`` or ``?``."""
    if view.plc_alive:
        return "alive"
    if view.plc_alive is None:
        return "-" if view.classic else "?"
    return "dead" if view.plc_claimed else "none"


def way_text(view: ChannelView) -> str:
    """Return where the messages go."""
    return {"to_plc": "→ PLC", "to_ros": "→ ROS"}.get(view.direction, "?")


def event_text(event: Event) -> str:
    """Return an event's place and words, without its time."""
    place = f"{event.topic}: " if event.topic else ""
    return f"{MARKS[event.level]} {place}{event.words}"


_NO_SILENCE = (State.DEAD, State.NO_BRIDGE, State.MISSING, State.UNKNOWN)
"""States with an event of their own, or too little known: that messages stop then is no further event."""


def channel_events(
    before: Mapping[str, ChannelView], after: Mapping[str, ChannelView], silent: set[str], time_ns: int
) -> Iterator[Event]:
    """Yield what happened to channels, each by its id, between two looks.

    ``silent`` has the channels with a ``stale`` that no ``recovered`` has followed; it is brought up to date.
    """
    for identifier, view in after.items():
        known = before.get(identifier)
        if known is None:
            yield _event(time_ns, "appeared", view, "the channel appeared", view.state.level)
        elif known != view:
            yield from _changes(known, view, time_ns)
        if view.state is State.UNREADABLE:
            continue
        if identifier in silent and (known is None or known.generation not in (0, view.generation)):
            silent.discard(identifier)
        elif identifier in silent and not view.silent:
            silent.discard(identifier)
            yield _event(time_ns, "recovered", view, "messages have resumed")
        elif view.silent and view.stale and identifier not in silent and view.state not in _NO_SILENCE:
            silent.add(identifier)
            words = view.words if view.classic else silence_words(view)
            yield _event(time_ns, "stale", view, words, Level.STALE)
    for identifier, view in before.items():
        if identifier not in after:
            silent.discard(identifier)
            yield _event(time_ns, "vanished", view, "the channel is gone", Level.WARN)


def _changes(before: ChannelView, after: ChannelView, time_ns: int) -> Iterator[Event]:
    broken = State.UNREADABLE
    if after.state is broken:
        if before.state is not broken or before.code != after.code:
            yield _event(time_ns, "unreadable", after, f"{after.words} [{after.code}]", Level.ERROR)
        return
    if before.state is broken:
        yield _event(time_ns, "readable", after, "the object can be read again")
        return
    if before.generation != after.generation:
        what = "the object was replaced"
        if before.layout_id != after.layout_id:
            what += f" and has another layout: {after.type_name}, {after.record_size} bytes"
        yield _event(time_ns, "replaced", after, what, Level.WARN)
        return
    yield from _counters(before, after, time_ns)
    if before.plc_alive and after.plc_alive is False:
        way = "reads" if after.direction == "to_plc" else "writes"
        yield _event(time_ns, "plc-gone", after, f"no PLC task {way} it any more", Level.ERROR)
    elif before.plc_alive is False and after.plc_alive:
        yield _event(time_ns, "plc-back", after, "a PLC task uses it again")


def _counters(before: ChannelView, after: ChannelView, time_ns: int) -> Iterator[Event]:
    for kind, what, count in (
        ("refused", "refused", after.refused - before.refused),
        ("truncated", "truncated", after.truncated - before.truncated),
        ("lost", "lost", after.lost - before.lost if after.state is State.LOST else 0),
    ):
        if count > 0:
            yield _event(time_ns, kind, after, f"{plural(count, 'message')} {what}", Level.WARN)


def bridge_events(
    before: tuple[BridgeView, ...], after: tuple[BridgeView, ...], time_ns: int
) -> Iterator[Event]:
    """Yield bridges that stopped beating or began to: one event each, however many channels they have."""
    known = {(bridge.prefix, bridge.name): bridge for bridge in before}
    for bridge in after:
        earlier = known.get((bridge.prefix, bridge.name))
        if earlier is None or earlier.alive is bridge.alive:
            continue
        who = f"bridge {bridge.name}" + (f", process {bridge.pid}," if bridge.pid else "")
        if bridge.alive is False and earlier.alive:
            level, what = (Level.ERROR, "has no heartbeat") if bridge.pid else (Level.WARN, "has ended")
            words = f"{who} {what}" + (f": {bridge.process}" if bridge.process else "")
            yield Event(time_ns, "bridge-gone", level, "", bridge.prefix, "", words)
        elif bridge.alive and earlier.alive is False:
            yield Event(time_ns, "bridge-back", Level.OK, "", bridge.prefix, "", f"{who} is alive again")


def grouped(events: Iterable[Event]) -> list[Event]:
    """Return events in order, those with the same words at the same look as one: a bridge has many channels.

    The ``topic`` of such an event is ``/a and 3 more``.
    """
    groups: dict[tuple[int, str, str, str], list[Event]] = {}
    for event in events:
        groups.setdefault((event.time_ns, event.kind, event.prefix, event.words), []).append(event)
    return [
        replace(group[0], topic=f"{group[0].topic} and {len(group) - 1} more") if len(group) > 1 else group[0]
        for group in groups.values()
    ]


def _event(time_ns: int, kind: str, view: ChannelView, words: str, level: Level = Level.OK) -> Event:
    return Event(time_ns, kind, level, view.id, view.prefix, view.label, words)
