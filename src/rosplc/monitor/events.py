"""What happened between two pictures."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import replace

from rosplc.harmless import plural
from rosplc.levels import Level
from rosplc.monitor.picture import BridgeView, ChannelView, Event, State, silence_words

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
            yield _event(time_ns, "recovered", view, "messages come again")
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
            what += f", and has another layout: {after.type_name}, {after.record_size} bytes"
        yield _event(time_ns, "replaced", after, what, Level.WARN)
        return
    yield from _counters(before, after, time_ns)
    if before.plc_alive and after.plc_alive is False:
        way = "reads" if after.direction == "to_plc" else "writes"
        yield _event(time_ns, "plc-gone", after, f"no PLC task {way} it any more", Level.ERROR)
    elif before.plc_alive is False and after.plc_alive:
        yield _event(time_ns, "plc-back", after, "a PLC task is there again")


def _counters(before: ChannelView, after: ChannelView, time_ns: int) -> Iterator[Event]:
    for kind, what, count in (
        ("refused", "refused", after.refused - before.refused),
        ("truncated", "cut to fit", after.truncated - before.truncated),
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
            level, what = (Level.ERROR, "does not beat any more") if bridge.pid else (Level.WARN, "has ended")
            words = f"{who} {what}" + (f": {bridge.process}" if bridge.process else "")
            yield Event(time_ns, "bridge-gone", level, "", bridge.prefix, "", words)
        elif bridge.alive and earlier.alive is False:
            yield Event(time_ns, "bridge-back", Level.OK, "", bridge.prefix, "", f"{who} beats again")


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
