"""The result of a look at the machine's channels, as frozen data and text, and the events between two looks.

The states' words and levels are those of ``/diagnostics``. A bridge reports more about its topics; a look
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
    """The state of a channel, worst first. The value is the word for display and JSON."""

    UNREADABLE = "unreadable"
    """The object cannot be used: damaged, not accessible to this user, or of another format."""
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
        """0 for ``ok``, higher for worse states."""
        return _SEVERITY[self]

    @property
    def level(self) -> Level:
        """The level in ``/diagnostics``."""
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
    """A claimed reader line; line 0 of a channel to ROS is the bridge's.

    ``task`` and ``pid`` are the reader's own data, for display; ``alive`` is None until it is known.
    ``taken`` is the sequence of the newest message taken; ``lost`` counts missed messages (a reader that
    takes only the newest misses some by design); ``retries`` counts copies discarded because the writer
    came too close; ``error`` is the reader's last error number, 0 for none.
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
    """The calls in an object of a service or action, which ``server`` (plc or ros) executes.

    ``number`` is the newest message's call, counted since its caller started, 0 before the first message;
    ``correlation`` is the same, unique over all runs of the caller, as 16 hexadecimal digits. ``status`` is
    the newest message's status as text, with the reason. ``open``: the newest call has not ended; None if
    unknown. ``ended`` counts, in the object of the answers, the calls that were seen to end, by outcome and
    reason; the first look counts those that are still in the object.
    """

    server: str
    number: int = 0
    correlation: str = ""
    status: str = ""
    open: bool | None = None
    ended: dict[str, int] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class ChannelView:
    """One channel at one moment. Text comes from the object and may contain any character.

    ``id`` is the object's name, unique on the machine, or ``classic:`` and the memory's name; ``topic`` is
    the ROS name of the topic, service or action, or the object's name if that is unknown; ``kind`` is
    ``topic``, ``service`` or ``action``; ``part`` is ``topic`` or the part of a service or action in this
    object; ``client`` is the name of one of several uses; ``call`` is None for a topic or if unknown.
    ``direction`` (``to_plc`` or ``to_ros``) and ``type_name`` are empty if unknown.

    ``words`` describes the state in a sentence, without times or numbers that change at each look; ``code``
    is the error code, if any. ``rate_hz`` covers the last seconds; it is None until known. ``age_ns`` is
    None before the first message, and exact after a message arrived during monitoring; before that, it is
    derived from the message's stamp and is at least the monitoring time. ``received`` is the sequence of the
    newest message, or for a classic topic, which has none, the number of observed changes; ``lost`` is the
    highest loss of any reader (a reader that takes only the newest misses some by design); ``refused``
    counts messages that did not fit into a record, ``truncated`` those with something cut off.

    ``writer_alive`` and ``reader_alive``, one of which is ``bridge_alive`` and the other ``plc_alive``, are
    None if unknown, or not yet known; ``plc_claimed``: the PLC's side holds a claim, is alive, or died
    without releasing the claim; ``bridge_pid`` is 0 if there is none. ``ros_peers`` is the number of ROS
    publishers, subscribers, clients or servers; None if they are not counted. ``stale``: the newest message
    is older than ``stale_after_ns`` (0 for never), which is configured if ``configured``, otherwise the
    default; ``silent``: the same, half a second later and half a second longer, so that one late message
    has no effect. ``generation`` is a random number, different for each object; ``created_ns`` is the
    creation time, ns since 1970 UTC.
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
        """The display name: ``/cmd_vel``, ``/gripper/close request left``."""
        return self.topic if self.kind == "topic" else f"{self.topic} {self.part} {self.client}".rstrip()

    def as_json(self) -> dict[str, Any]:
        """Return plain data; ``state`` as a word, with its ``level`` and ``severity``."""
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
    """One bridge as shown by its channels.

    ``pid`` is the process number that the bridge wrote, 0 if it has ended; ``alive`` is None until known;
    ``process`` is the state of its process as text, if it has no heartbeat; ``worst`` is the worst state
    among its channels.
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
    """An event between two looks, detected at ``time_ns`` since 1970 UTC.

    ``kind`` is ``appeared``, ``vanished``, ``replaced``, ``unreadable``, ``readable``, ``stale``,
    ``recovered``, ``refused``, ``lost``, ``truncated``, ``bridge-gone``, ``bridge-back``, ``plc-gone`` or
    ``plc-back``; ``level`` is OK for no problem, or its end; ``channel`` is the channel's id, empty (like
    ``topic``) for an event of a whole bridge; ``words`` is a sentence.
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

    Channels are sorted by prefix, topic and id, bridges by prefix and name. ``events`` occurred since the
    previous look; ``notes`` explain why the picture is incomplete.
    """

    time_ns: int
    channels: tuple[ChannelView, ...]
    bridges: tuple[BridgeView, ...] = ()
    events: tuple[Event, ...] = ()
    notes: tuple[str, ...] = ()

    @property
    def worst(self) -> State:
        """The worst state among the channels; ``ok`` if there are none (null in JSON)."""
        return max((each.state for each in self.channels), key=lambda state: state.severity, default=State.OK)

    @property
    def wrong(self) -> tuple[ChannelView, ...]:
        """The channels with a problem, worst first."""
        found = (each for each in self.channels if each.state not in ALL_WELL)
        return tuple(sorted(found, key=lambda each: -each.state.severity))

    def channel(self, identifier: str) -> ChannelView | None:
        """Return the channel with an id; None if it does not exist, or no longer exists."""
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
    """Return a channel's state and a sentence for it; of several problems, the worst counts.

    ``starting``: the bridge has a claim but is too young for a heartbeat. ``lost_lately``: messages were
    lost on a topic where each one matters.
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
        return State.LOST, "messages that should be read are lost; raise slots: or read more each scan"
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
    return State.OK, "messages arrive" if seen.rate_hz else "no message at present (this is allowed)"


def _no_plc(seen: ChannelView) -> tuple[State, str]:
    if seen.call is not None:
        return State.NO_PLC, f"no PLC task {'serves' if seen.call.server == 'plc' else 'calls'} it"
    if seen.direction != "to_plc":
        return State.NO_PLC, "no PLC task writes it"
    nothing = "" if seen.received else f", and {silence_words(seen)}"
    return State.NO_PLC, f"no PLC task reads it{nothing}"


def silence_words(seen: ChannelView) -> str:
    """Return a sentence about a source that is silent, or was silent until a moment ago."""
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
"""One character per level, for people who cannot distinguish colours; in any character set."""


def state_text(view: ChannelView) -> str:
    """Return the mark and word of the state: ``X dead``."""
    return f"{MARKS[view.state.level]} {view.state.value}"


def rate_text(rate_hz: float | None) -> str:
    """Return a rate in Hz with three digits; ``-`` if it is not known."""
    if rate_hz is None:
        return "-"
    return f"{rate_hz:.0f}" if rate_hz >= 100 or rate_hz == 0 else f"{rate_hz:.3g}"


def age_text(age_ns: int | None) -> str:
    """Return an age: ``12 ms``, ``1.2 s``, ``14 s``, ``3 min``; ``never`` before the first message."""
    if age_ns is None:
        return "never"
    return f"{age_ns // 1_000_000} ms" if age_ns < 100_000_000 else format_age(age_ns)


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
    """Return the state of the PLC's side of a channel: ``alive``, ``dead``, ``none`` or ``?``."""
    if view.plc_alive:
        return "alive"
    if view.plc_alive is None:
        return "-" if view.classic else "?"
    return "dead" if view.plc_claimed else "none"


def way_text(view: ChannelView) -> str:
    """Return the direction of the messages."""
    return {"to_plc": "→ PLC", "to_ros": "→ ROS"}.get(view.direction, "?")


def event_text(event: Event) -> str:
    """Return an event's location and text, without its time."""
    place = f"{event.topic}: " if event.topic else ""
    return f"{MARKS[event.level]} {place}{event.words}"


_NO_SILENCE = (State.DEAD, State.NO_BRIDGE, State.MISSING, State.UNKNOWN)
"""States with their own event, or with too little data: stopped messages then cause no further event."""


def channel_events(
    before: Mapping[str, ChannelView], after: Mapping[str, ChannelView], silent: set[str], time_ns: int
) -> Iterator[Event]:
    """Yield the events of channels (by id) between two looks.

    ``silent`` has the channels whose last such event is ``stale``, not ``recovered``; it is updated.
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
    """Yield one event for each bridge whose heartbeat stopped or started, regardless of its channels."""
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
    """Return events in order; events with the same text at the same look are merged into one.

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
