"""The objects of this machine, watched for a while: which processes hold them, which sides have a heartbeat.

Nothing is mapped, locked or written: everything is read with ``pread`` and from ``/proc/locks``. Trying a
lock would take it, and keep a starting bridge from it. The objects that a running bridge and a running PLC
share are compared with the configuration.
"""

from __future__ import annotations

import os
import stat
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import cast

from rosplc.doctor.finding import Finding, Level
from rosplc.doctor.kinds import fine, found, judged
from rosplc.errors import ChannelError
from rosplc.harmless import listed, plural
from rosplc.layout import Layout
from rosplc.monitor.tracked import WRITER, Peers, is_starting, process_words
from rosplc.proc import Held, file_key, holder
from rosplc.shm import Description, Direction, Identity, Namespace, Part, ReaderState, Region, Snapshot
from rosplc.shm.constants import HEADER_SIZE, KIND_TOPIC
from rosplc.shm.files import open_plain_file
from rosplc.shm.names import file_name

_PAUSE_S = 0.05
_LEAST_MS, _LEAST_UNHELD_S, _MOST_S = 667, 0.5, 3.5
"""A program that should beat ten times per second may be late on a busy machine."""


@dataclass(frozen=True)
class Seen:
    """One object during its examination.

    ``topic`` is the topic, service or action from its name or self-description, or else the object's name;
    ``status`` has owner, mode and size, for a link those of the link. ``error`` is the format check that
    failed; ``identity`` (lines 0 and 1) and ``description`` are None if they cannot be read; ``snapshot`` has
    the counters at the end. ``held``: a bridge holds its lock, None if unknown; ``bridge_beats`` and
    ``plc_beats``: that side had a heartbeat; ``plc_lines``: in an object that the PLC reads, the reader lines
    with a heartbeat.
    """

    path: Path
    prefix: str
    topic: str
    status: os.stat_result
    error: ChannelError | None = None
    identity: Identity | None = None
    description: Description | None = None
    snapshot: Snapshot | None = None
    held: bool | None = None
    bridge_beats: bool = False
    plc_beats: bool = False
    plc_lines: tuple[ReaderState, ...] = ()

    @property
    def label(self) -> str:
        """The object's name for people: ``/cmd_vel``, ``/gripper/close request left``."""
        if self.description is None or self.description.part is Part.TOPIC:
            return self.topic
        return f"{self.topic} {self.description.part.word} {self.description.client}".rstrip()

    @property
    def live(self) -> bool:
        """Whether a bridge uses the object now; across containers, only the heartbeat shows this."""
        return bool(self.held) or self.bridge_beats

    @property
    def bridge_pid(self) -> int:
        """The process id that the bridge wrote; 0 if it has no claim."""
        if self.snapshot is None or self.identity is None:
            return 0
        line = self.snapshot.bridge(self.identity.direction)
        return line.pid if line else 0


@dataclass(frozen=True)
class Objects:
    """What was found under all prefixes: objects, and the paths of lock files and temporary files."""

    objects: tuple[Seen, ...] = ()
    locks: frozenset[Path] = frozenset()
    temporaries: tuple[Path, ...] = ()

    def of(self, namespace: Namespace, topic: str, part: Part = Part.TOPIC, client: str = "") -> Seen | None:
        """Return the object of a topic, or of a part of a service or action; None if there is none."""
        path = namespace.path(topic, part, client)
        return next((seen for seen in self.objects if seen.path == path), None)


class _Image:
    """A copy of a header, read word by word as a mapped region would be."""

    def __init__(self, data: bytes) -> None:
        self._data = data

    def word(self, offset: int) -> int:
        return int.from_bytes(self._data[offset : offset + 4], "little")

    def words(self, offset: int, count: int) -> tuple[int, ...]:
        return tuple(self.word(at) for at in range(offset, offset + 4 * count, 4))


def lock_holders(directory: Path, prefix: str, held: Held) -> list[int]:
    """Return the processes that hold the names of a prefix, without those of other PID namespaces."""
    pids = {holder(path, held) for path in directory.glob(f"{prefix}.l*.*")}
    return sorted(pids - {0})


def lock_of(path: Path) -> Path:
    """Return the lock file of an object."""
    found = file_name(path.name)
    return path if found is None else path.with_name(found.lock)


def is_held(path: Path, held: Held | None) -> bool | None:
    """Return whether a process holds an flock on a file; None if the kernel does not show this."""
    if held is None:
        return None
    try:
        return file_key(path) in held
    except OSError:
        return False


@dataclass
class _Watched:
    fd: int
    seen: Seen
    last: Snapshot
    peers: Peers = field(default_factory=Peers)

    def look(self, passed_s: float) -> bool:
        """Look once more; return whether somebody has a claim, and may still be about to move."""
        self.last = _snapshot(self.fd)
        writer, now_ns = self.last.writer, int(passed_s * 1e9)
        lines = [(WRITER, writer.epoch, writer.beat_ms, writer.beat, writer.head)]
        lines += [(line.index, line.claim, line.beat_ms, line.beat, line.taken) for line in self.last.readers]
        alive = [
            self.peers.alive(key, claim, max(beat_ms, _LEAST_MS), beat, count, now_ns)
            for key, claim, beat_ms, beat, count in lines
        ]
        # What nobody has locked is a dead bridge's; only another container's lock would not be seen.
        return None in alive and (self.seen.held is not False or passed_s < _LEAST_UNHELD_S)

    def result(self) -> Seen:
        assert self.seen.identity is not None
        to_plc, topic = (
            self.seen.identity.direction is Direction.TO_PLC,
            self.seen.identity.kind == KIND_TOPIC,
        )
        lines = [line for line in self.last.readers if self.peers.seen(line.index)]
        plc_lines = tuple(line for line in lines if topic or line.index == 0) if to_plc else ()
        return replace(
            self.seen,
            snapshot=self.last,
            bridge_beats=self.peers.seen(WRITER if to_plc else 0),
            plc_beats=bool(plc_lines) if to_plc else self.peers.seen(WRITER),
            plc_lines=plc_lines,
        )


def _snapshot(fd: int) -> Snapshot:
    data = os.pread(fd, HEADER_SIZE, 0).ljust(HEADER_SIZE, b"\0")
    return Snapshot.of(cast(Region, _Image(data)))


def look_at_objects(
    directory: Path,
    held: Held | None,
    *,
    prefix: str | None = None,
    seconds: float = _MOST_S,
    sleep: Callable[[float], None] = time.sleep,
) -> Objects:
    """Watch every object until the heartbeat of each running side is seen, for at most ``seconds``.

    Raises OSError if the directory cannot be listed.
    """
    locks: set[Path] = set()
    temporaries: list[Path] = []
    done: list[Seen] = []
    watched: list[_Watched] = []
    try:
        for path in sorted(directory.iterdir()):
            found = file_name(path.name)
            if found is None or prefix not in (None, found.prefix):
                continue
            if found.role == "l":
                locks.add(path)
            elif found.role == "n":
                temporaries.append(path)
            else:
                _open(path, found.prefix, held, done, watched)
        _watch(watched, seconds, sleep)
        done += [each.result() for each in watched]
    finally:
        for each in watched:
            os.close(each.fd)
    objects = tuple(sorted(done, key=lambda seen: seen.path))
    return Objects(objects, frozenset(locks), tuple(temporaries))


def _open(path: Path, prefix: str, held: Held | None, done: list[Seen], watched: list[_Watched]) -> None:
    try:
        status = path.lstat()
    except FileNotFoundError:
        return  # removed meanwhile
    namespace = Namespace(prefix, path.parent)
    topic, part = (namespace.name_of(path.name) or (path.name,))[0], namespace.part_of(path.name)
    assert part is not None
    seen = Seen(path, prefix, topic, status, held=is_held(lock_of(path), held))
    try:
        fd = open_plain_file(path, os.O_RDONLY)
    except ChannelError as error:
        if error.code != "SHM101":
            done.append(replace(seen, error=error))
        return
    try:
        head, size = os.pread(fd, HEADER_SIZE, 0), os.fstat(fd).st_size
        identity = Identity.parse(head, size, kind=part.value, where=str(path), accept_retired=True)
        text = os.pread(fd, identity.description_size, identity.description_offset)
        description = Description.from_json(text, str(path), part)
    except ChannelError as error:
        os.close(fd)
        if stat.S_ISREG(status.st_mode):
            done.append(replace(seen, error=error))
        return
    except BaseException:
        os.close(fd)
        raise
    # A shortened name does not give its topic away, its description does.
    sound = replace(seen, topic=description.topic, identity=identity, description=description)
    watched.append(_Watched(fd, sound, _snapshot(fd)))


def _watch(watched: list[_Watched], seconds: float, sleep: Callable[[float], None]) -> None:
    slept = 0.0
    while sum(each.look(slept) for each in watched) and slept < seconds:
        sleep(_PAUSE_S)
        slept += _PAUSE_S


_NO_LAYOUT = "0" * 16
_RESTART = "See the bridge's log, and restart the bridge."


@dataclass(frozen=True)
class Carried:
    """An object that the configuration requires, and the existing object with its name.

    ``use`` is the topic, or the service or action with its client; ``name`` distinguishes its objects.
    """

    use: str
    name: str
    direction: Direction
    layout: Layout
    seen: Seen | None

    @property
    def live(self) -> bool:
        """Whether a bridge uses the object now."""
        return self.seen is not None and self.seen.live


def holders(topics: Sequence[Carried], classic: Mapping[str, bool], config: str) -> Iterator[Finding]:
    """Report whether a bridge holds the topics.

    ``classic`` maps each classic topic to whether a bridge holds the lock file of its memory.
    """
    held = {each.use: each.live for each in topics} | dict(classic)
    calls = any(each.use != each.name for each in topics)
    start, count = f"rosplc run {config}", plural(len(held), "entry" if calls else "topic")
    if not held:
        return
    if not any(held.values()):
        yield found("DOC601", f"no bridge is running for {count}", command=start)
        return
    missing = [topic for topic, is_held in held.items() if not is_held]
    what = f"a bridge is running, but does not carry {listed(missing)}" if missing else ""
    remedy = "Restart the bridge with this configuration."
    yield judged("DOC601", what, f"a bridge carries {count}", remedy, start if missing else "", Level.WARNING)
    silent = [
        each.use
        for each in topics
        if each.live and each.seen and not each.seen.bridge_beats and not is_starting(each.seen.bridge_pid)
    ]
    if silent:
        what = f"the bridge for {listed(dict.fromkeys(silent))} has no heartbeat: it hangs or is stopped"
        yield found("DOC601", what, _RESTART, level=Level.ERROR)


def bridges(objects: Objects) -> Iterator[Finding]:
    """Report whether each bridge on this machine has a heartbeat, whatever its prefix."""
    groups: dict[tuple[str, str], list[Seen]] = {}
    for seen in objects.objects:
        if seen.live and seen.description is not None:
            groups.setdefault((seen.prefix, seen.description.bridge), []).append(seen)
    for (prefix, name), held in sorted(groups.items()):
        bridge, count = f"bridge {name} (prefix {prefix})", plural(len(held), "object")
        silent = [seen for seen in held if not seen.bridge_beats]
        pid = max((seen.bridge_pid for seen in silent), default=0)
        if not silent:
            yield fine("DOC601", f"{bridge} is running with {count}")
        elif is_starting(pid):
            yield fine("DOC601", f"{bridge} is starting with {count}")
        else:
            words = process_words(pid) if pid else ""
            why = f"{words} (process {pid})" if words else "it hangs or is stopped"
            what = f"{bridge} has no heartbeat for {listed(seen.label for seen in silent)}: {why}"
            yield found("DOC601", what, _RESTART, level=Level.ERROR)


def layouts(topics: Sequence[Carried]) -> Iterator[Finding]:
    """Compare the objects of running bridges with the configuration."""
    wrong = [
        found("DOC602", f"{each.name} has {difference}")
        for each in topics
        if each.seen is not None and each.seen.identity is not None and each.live
        if (difference := _difference(each, each.seen))
    ]
    yield from wrong
    if not wrong and any(each.live for each in topics):
        yield fine("DOC602", "running bridge and configuration have the same layouts")


def _difference(plan: Carried, seen: Seen) -> str:
    identity, description = seen.identity, seen.description
    assert identity is not None
    if identity.direction is not plan.direction:
        return f"direction {identity.direction.word} instead of {plan.direction.word}"
    if identity.layout_id == plan.layout.layout_id:
        return ""
    what = f"layout {identity.layout_id} instead of {plan.layout.layout_id}"
    if description is None:
        return what
    if description.type != plan.layout.type_name:
        return f"{what}: type {description.type} instead of {plan.layout.type_name}"
    limits = plan.layout.limits.to_dict()
    there = {key: value for key, value in description.limits.items() if limits.get(key) != value}
    here = {key: limits.get(key) for key in there}
    return f"{what}: limits {there} instead of {here}" if there else f"{what}: the definitions differ"


def beating(topics: Sequence[Carried]) -> Iterator[Finding]:
    """Report topics that no PLC task uses, and layouts that running tasks expect."""
    live = [(each, each.seen) for each in topics if each.live and each.seen is not None]
    if not live:
        return
    idle = dict.fromkeys(plan.use for plan, seen in live if not seen.plc_beats)
    what = f"no running PLC task uses {listed(idle)}" if idle else ""
    yield judged("DOC603", what, f"running PLC tasks use {plural(len(live), 'object')}")
    refused = []
    for plan, seen in live:
        if plan.direction is not Direction.TO_PLC or seen.identity is None:
            continue  # a PLC that writes leaves no layout: with another one it does not claim
        actual = seen.identity.layout_id
        for line in seen.plc_lines:
            task = f"task {line.task}" if line.task else f"process {line.pid}"
            if line.layout_id not in (actual, _NO_LAYOUT):
                what = f"{task} expects layout {line.layout_id}, but the object has layout {actual}"
                refused.append(found("DOC604", f"{plan.name}: {what}"))
            elif line.error:
                code = f"SHM{line.error:03d}"
                what = f"{plan.name}: {task} reports error {code}"
                refused.append(found("DOC604", what, f"Run `rosplc explain {code}`."))
    yield from refused or [fine("DOC604", "no PLC task expects a different layout")]


def refusals(topics: Sequence[Carried]) -> Iterator[Finding]:
    """Report topics whose messages were refused or truncated."""
    counts = []
    for each in topics:
        if each.live and each.seen is not None and each.seen.snapshot is not None:
            writer = each.seen.snapshot.writer
            if writer.refused or writer.truncated:
                counts.append(f"{each.name}: {writer.refused} messages refused, {writer.truncated} truncated")
    if counts or any(each.live for each in topics):
        yield judged("DOC605", "; ".join(counts), "no message was refused or truncated")
