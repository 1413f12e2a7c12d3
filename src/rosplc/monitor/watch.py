"""Repeated looks at all channels of the machine, without side effects.

A look lists the directory, reads the control words of each object, and compares them with the previous look.
Objects may appear, vanish, be replaced or be damaged; this is never an error. Nothing is claimed or written:
an observer uses no reader line and maps objects read-only.
"""

from __future__ import annotations

import os
from collections.abc import Collection
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, NamedTuple

from rosplc.clock import SYSTEM, Clock
from rosplc.described import layout_of
from rosplc.errors import ChannelError
from rosplc.monitor.classic import ClassicWatch, Expected
from rosplc.monitor.message import Message, joined, message_of
from rosplc.monitor.picture import (
    BridgeView,
    ChannelView,
    Event,
    Picture,
    State,
    bridge_events,
    channel_events,
)
from rosplc.monitor.tracked import Tracked, any_alive, process_words
from rosplc.shm import Attached, Namespace, Part, Reader, open_object
from rosplc.shm.header import channel_error
from rosplc.shm.names import file_name

MAX_CHANNELS = 4096  # more objects than this are not looked at, and a note says so

MAX_RECORD = 256 * 1024 * 1024
"""Record size in bytes above which messages are not decoded, to save memory."""

_RETRY_NS = 1_000_000_000


class _File(NamedTuple):
    """The directory entry of an object."""

    name: str
    prefix: str
    inode: int
    size: int


class _Broken(NamedTuple):
    """An object that could not be opened; it is tried again when it changes, and about once a second."""

    file: _File
    error: ChannelError
    retry_ns: int


class Watch:
    """Looks at the channels of this machine; a context manager. For one thread at a time.

    It looks at one prefix or several, None for all; at one ``topic``, service or action, None for all; with
    ``calls`` also at the objects of services and actions. ``expected`` has the expectations of
    configurations; otherwise, defaults apply. Ages, rates and signs of life are judged by ``clock``.
    ``prefixes`` has the requested ones, empty for all. Raises ChannelError SHM118 if the prefix is not valid.
    """

    def __init__(
        self,
        prefix: str | Collection[str] | None = None,
        *,
        directory: str = "/dev/shm",
        expected: Expected | None = None,
        topic: str | None = None,
        calls: bool = False,
        clock: Clock = SYSTEM,
    ) -> None:
        prefixes = (prefix,) if isinstance(prefix, str) else prefix
        self._names = {each: Namespace(each, directory) for each in prefixes or ()}
        self._all = prefixes is None
        self.prefixes = frozenset(self._names)
        self._topic = topic
        self._calls = calls
        self.clock = clock
        self._directory = directory
        self._expected = expected or Expected()
        self._tracked: dict[str, tuple[_File, Tracked]] = {}
        self._broken: dict[str, _Broken] = {}
        self._classic = [
            ClassicWatch(each_prefix, topic)
            for each_prefix, topic in self._expected.classic
            if self._wanted(each_prefix, topic.topic)
        ]
        self._before: dict[str, ChannelView] | None = None
        self._silent: set[str] = set()
        self._bridges: tuple[BridgeView, ...] = ()

    def __enter__(self) -> Watch:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Unmap everything; a second call does nothing."""
        for _, tracked in self._tracked.values():
            tracked.close()
        self._tracked.clear()

    def look(self) -> Picture:
        """Look at every channel once; call this one to ten times per second.

        Rates and signs of life are unknown in the first picture. Raises ChannelError SHM123 if the directory
        cannot be listed.
        """
        now, wall = self.clock.monotonic_ns(), self.clock.time_ns()
        files, notes = self._list()
        for name in self._tracked.keys() - files.keys():
            self._drop(name)
        for name in self._broken.keys() - files.keys():
            del self._broken[name]
        views = [self._view(file, now, wall) for file in files.values()]
        views += [watch.look(now) for watch in self._classic]
        views += self._missing(views)
        views = sorted(joined(views), key=lambda view: (view.prefix, view.topic, view.id))
        return self._picture(tuple(views), wall, notes)

    def message(self, channel: ChannelView | str, elements: int | None = None) -> Message | None:
        """Return the newest message of a channel or channel id; None if there is none yet.

        At most ``elements`` of each array are decoded; a longer array becomes an
        :class:`rosplc.layout.view.Excerpt` (None: all). Raises ChannelError SHM101 if the channel is gone,
        SHM113 if its type cannot be rebuilt, or the error that prevents reading it.
        """
        identifier = channel if isinstance(channel, str) else channel.id
        classic = next((each for each in self._classic if each.id == identifier), None)
        if classic is not None:
            return classic.message(elements)
        if identifier in self._broken:
            raise self._broken[identifier].error
        if identifier not in self._tracked:
            raise channel_error(101, where=identifier)
        tracked = self._tracked[identifier][1]
        attached = tracked.attached
        if not self._sound(attached):
            raise channel_error(101, where=attached.path)
        if attached.identity.record_size > MAX_RECORD:
            what = f"a message of {attached.identity.record_size >> 20} MiB is too large to show"
            raise channel_error(112, what, attached.path)
        layout = layout_of(attached)
        found = Reader(attached.region, 0).peek_record()
        return None if found is None else message_of(identifier, layout, *found, elements, tracked.part)

    def _wanted(self, prefix: str, topic: str | None = None, *, name: str = "") -> bool:
        """Return whether a topic, or the object with a name, is to be monitored."""
        if not self._all and prefix not in self._names:
            return False
        if self._topic is None:
            return True
        namespace = Namespace(prefix, self._directory)
        names = [namespace.object_name(self._topic, part) for part in Part]
        return topic == self._topic or name in names or (namespace.name_of(name) or ("",))[0] == self._topic

    def _sound(self, attached: Attached) -> bool:
        """Return whether the name still refers to the object, and the object still has its size."""
        try:
            size = os.stat(attached.path, follow_symlinks=False).st_size  # noqa: PTH116
        except OSError:
            return False
        return size >= attached.identity.object_size and attached.still_there()

    def _list(self) -> tuple[dict[str, _File], tuple[str, ...]]:
        found: dict[str, _File] = {}
        more = 0
        try:
            with os.scandir(self._directory) as entries:
                for entry in entries:
                    named = file_name(entry.name)
                    if named is None or named.role != "t" or not self._wanted(named.prefix, name=entry.name):
                        continue
                    if not self._calls and not entry.name.startswith(f"{named.prefix}.t."):
                        continue
                    if len(found) >= MAX_CHANNELS:
                        more += 1
                        continue
                    try:
                        status = entry.stat(follow_symlinks=False)
                    except OSError:
                        continue  # gone in between
                    found[entry.name] = _File(entry.name, named.prefix, status.st_ino, status.st_size)
        except OSError as error:
            raise channel_error(123, f"cannot list files: {error.strerror}", self._directory) from error
        return found, ((f"{more} more objects were not examined",) if more else ())

    def _view(self, file: _File, now: int, wall: int) -> ChannelView:
        error: ChannelError
        for _ in range(2):  # once more where the object was retired since the directory was listed
            try:
                tracked = self._track(file, now)
            except ChannelError as reason:
                error = reason
                break
            expectation = self._expected.of(
                file.prefix, tracked.description.topic, tracked.direction, tracked.part
            )
            try:
                return tracked.look(expectation, now, wall)
            except ChannelError as reason:
                self._drop(file.name)
                error = reason
        namespace = Namespace(file.prefix, self._directory)
        (topic, client), part = namespace.name_of(file.name) or (file.name, ""), namespace.part_of(file.name)
        assert part is not None
        return ChannelView(
            file.name, file.prefix, topic, state=State.UNREADABLE, words=error.what, code=error.code,
            object_size=file.size, kind=part.kind, part=part.word, client=client,
        )  # fmt: skip

    def _track(self, file: _File, now: int) -> Tracked:
        known = self._tracked.get(file.name)
        if known is not None:
            before, tracked = known
            if before.inode == file.inode and file.size >= tracked.attached.identity.object_size:
                return tracked
            # A file that became shorter must not be touched: that would end this process.
            self._drop(file.name)
        broken = self._broken.get(file.name)
        if broken is not None and broken.file == file and now < broken.retry_ns:
            raise broken.error
        try:
            tracked = self._open(file, now)
        except ChannelError as error:
            self._broken[file.name] = _Broken(file, error, now + _RETRY_NS)
            raise
        self._tracked[file.name] = (file, tracked)
        self._broken.pop(file.name, None)
        return tracked

    def _open(self, file: _File, now: int) -> Tracked:
        attached = open_object(str(Path(self._directory) / file.name))
        try:
            return Tracked(Namespace(file.prefix, self._directory), file.name, attached, now)
        except BaseException:
            attached.close()
            raise

    def _drop(self, name: str) -> None:
        known = self._tracked.pop(name, None)
        if known is not None:
            known[1].close()

    def _missing(self, views: list[ChannelView]) -> list[ChannelView]:
        there = {view.id for view in views}
        wanted = [(prefix, topic, Part.TOPIC, "") for prefix, topic in self._expected.topics]
        return [
            ChannelView(
                id=identifier,
                prefix=prefix,
                topic=topic,
                state=State.MISSING,
                words="the channel is configured but has no object: its bridge is not running",
                code="SHM101",
                configured=True,
                kind=part.kind,
                part=part.word,
                client=client,
            )
            for prefix, topic, part, client in (*wanted, *(self._expected.calls if self._calls else ()))
            if self._wanted(prefix, topic)
            and (identifier := Namespace(prefix, self._directory).object_name(topic, part, client))
            not in there
        ]

    def _picture(self, views: tuple[ChannelView, ...], wall: int, notes: tuple[str, ...]) -> Picture:
        after = {view.id: view for view in views}
        bridges = _bridges(views)
        events: list[Event] = []
        if self._before is None:
            self._silent = {view.id for view in views if view.silent}
        else:
            events += bridge_events(self._bridges, bridges, wall)
            events += channel_events(self._before, after, self._silent, wall)
        self._before = {name: _known_life(self._before, view) for name, view in after.items()}
        known = {(bridge.prefix, bridge.name): bridge.alive for bridge in self._bridges}
        self._bridges = tuple(
            replace(one, alive=known.get((one.prefix, one.name))) if one.alive is None else one
            for one in bridges
        )
        return Picture(wall, views, bridges, tuple(events), notes)


def _known_life(before: dict[str, ChannelView] | None, view: ChannelView) -> ChannelView:
    """Return a view with the last known state of the PLC if the state is not known yet.

    A returning PLC has a new claim without an observed heartbeat: dead, unknown, alive is one return.
    """
    earlier = before.get(view.id) if before and view.plc_alive is None else None
    return view if earlier is None else replace(view, plc_alive=earlier.plc_alive)


def _bridges(views: tuple[ChannelView, ...]) -> tuple[BridgeView, ...]:
    groups: dict[tuple[str, str], list[ChannelView]] = {}
    for view in views:
        if view.bridge:
            groups.setdefault((view.prefix, view.bridge), []).append(view)
    bridges = []
    for (prefix, name), group in sorted(groups.items()):
        alive = any_alive(view.bridge_alive for view in group)
        pid = max(view.bridge_pid for view in group)
        bridges.append(
            BridgeView(
                prefix=prefix,
                name=name,
                pid=pid,
                alive=alive,
                channels=len(group),
                worst=max((view.state for view in group), key=lambda state: state.severity),
                process=process_words(pid) if alive is False and pid else "",
            )
        )
    return tuple(bridges)


_LOOKS = 4
_SHARED = (
    "prefix", "topic", "type_name", "direction", "record_size", "slots", "layout_id", "bridge", "refused",
    "truncated", "kind", "part", "client",
)  # fmt: skip


@dataclass(frozen=True, slots=True)
class ObjectState:
    """The state of one object."""

    prefix: str  # the bridge's prefix
    topic: str  # as ROS writes it, a service or action likewise; the object's name where that cannot be known
    path: str  # the object's file
    type_name: str = ""  # ``package/msg/Name``, empty if unreadable
    direction: str = ""  # ``to_plc`` or ``to_ros``, empty if unreadable
    record_size: int = 0  # bytes of a record
    slots: int = 0  # number of slots
    layout_id: str = ""  # 16 hexadecimal digits
    bridge: str = ""  # the bridge's name
    head: int = 0  # sequence of the newest message
    refused: int = 0  # messages that the writer could not put into a record
    truncated: int = 0  # messages with something cut off
    writer_alive: bool = False  # whether the writer beat while looking
    readers: tuple[str, ...] = ()  # names of the tasks whose reader lines beat while looking
    error: str = ""  # why it cannot be read, as an error's text; empty if it can
    code: str = ""  # the error's code
    kind: str = "topic"  # ``topic``, ``service`` or ``action``
    part: str = "topic"  # ``topic``, or what a service's or action's object carries: ``request``, ``goal``
    client: str = ""  # the name of one of several uses of a service or action

    def to_dict(self) -> dict[str, Any]:
        """Return plain data for JSON."""
        return {name: getattr(self, name) for name in self.__slots__}


def find_objects(
    directory: str = "/dev/shm",
    *,
    prefix: str | None = None,
    seconds: float = 0.35,
    calls: bool = False,
    clock: Clock = SYSTEM,
) -> list[ObjectState]:
    """Return the state of every topic's object on this machine, sorted by prefix and topic.

    ``seconds`` is how long to observe heartbeats (a bridge's default period is 0.1 s); ``calls``: include the
    objects of services and actions. Objects that cannot be read have an error. Raises ChannelError SHM118 if
    the prefix is not valid, SHM123 if the directory cannot be listed.
    """
    with Watch(prefix, directory=directory, calls=calls, clock=clock) as watch:
        picture = watch.look()
        for _ in range(_LOOKS if seconds and picture.channels else 0):
            clock.sleep(round(seconds / _LOOKS * 1e9))
            picture = watch.look()
    return [_state(view, directory) for view in picture.channels]


def _state(view: ChannelView, directory: str) -> ObjectState:
    path = str(Path(directory) / view.id)
    if view.state is State.UNREADABLE:
        told = {name: getattr(view, name) for name in ("kind", "part", "client")}
        return ObjectState(view.prefix, view.topic, path, error=view.words, code=view.code, **told)
    return ObjectState(
        **{name: getattr(view, name) for name in _SHARED},
        path=path,
        head=view.received,
        writer_alive=view.writer_alive is True,
        readers=tuple(each.task or f"process {each.pid}" for each in view.readers if each.alive),
    )
