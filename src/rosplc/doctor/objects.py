"""The objects of this machine, watched for a while: which processes hold them, and which sides beat.

Nothing is mapped, locked or written: everything is read with ``pread`` and from ``/proc/locks``. To try a
lock is to take it, which would keep a starting bridge out.
"""

from __future__ import annotations

import os
import re
import stat
import time
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import cast

from rosplc.errors import ChannelError
from rosplc.shm import Description, Direction, Identity, Namespace, ReaderState, Region, Snapshot
from rosplc.shm.constants import HEADER_SIZE
from rosplc.shm.files import open_plain_file

_NAME = re.compile(r"([A-Za-z][A-Za-z0-9_-]{0,31})\.([tln])\.(.+)")
_PAUSE_S = 0.05
_LEAST_S, _LEAST_UNHELD_S, _MOST_S = 2.0, 0.5, 3.5
"""Who promises to beat ten times a second may still not get to it on a machine with other work."""

Held = Mapping[tuple[int, int, int], int]
"""Locked files (device's major and minor number, inode) → the process that holds the lock."""


@dataclass(frozen=True)
class Seen:
    """One object while it was looked at.

    Attributes:
        topic: The topic, as far as name or self-description tell; else the object's name.
        status: Owner, mode and size; of a link, the link's own.
        error: The check of the format that failed; None if it is sound.
        identity: Lines 0 and 1; None if they cannot be read.
        description: The self-description; None if it cannot be read.
        snapshot: The counters at the end.
        held: Whether a bridge holds its lock; None if that cannot be seen.
        bridge_beats: Whether the bridge's side moved.
        plc_beats: Whether a PLC's side moved.
        plc_lines: Towards the PLC: the reader lines that moved.
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
    def live(self) -> bool:
        """Whether a bridge has it now; over containers only the beat can tell."""
        return bool(self.held) or self.bridge_beats

    @property
    def bridge_pid(self) -> int:
        """The bridge's process, as it wrote it; 0 if it has no claim."""
        if self.snapshot is None or self.identity is None:
            return 0
        if self.identity.direction is Direction.TO_PLC:
            return self.snapshot.writer.pid if self.snapshot.writer.epoch else 0
        return next((line.pid for line in self.snapshot.readers if line.index == 0 and line.claim), 0)


@dataclass(frozen=True)
class Objects:
    """What was found under all prefixes: objects by path, and the paths of lock files and temporaries.

    ``locks_seen``: the kernel's list of locks could be read.
    """

    objects: tuple[Seen, ...] = ()
    locks: frozenset[Path] = frozenset()
    temporaries: tuple[Path, ...] = ()
    locks_seen: bool = True

    def of(self, namespace: Namespace, topic: str) -> Seen | None:
        """Return a topic's object; None if there is none."""
        path = namespace.path(topic)
        return next((seen for seen in self.objects if seen.path == path), None)


class _Image:
    """A copy of a header, read word by word as a mapped region would be."""

    def __init__(self, data: bytes) -> None:
        self._data = data

    def word(self, offset: int) -> int:
        return int.from_bytes(self._data[offset : offset + 4], "little")

    def words(self, offset: int, count: int) -> tuple[int, ...]:
        return tuple(self.word(at) for at in range(offset, offset + 4 * count, 4))


def held_files(proc: Path) -> Held | None:
    """Return the files that processes hold an flock on; None if the kernel does not show them."""
    try:
        text = (proc / "locks").read_text(encoding="utf-8", errors="replace")
    except OSError:
        return None
    found = {}
    for line in text.splitlines():
        words = line.split()
        if len(words) >= 6 and words[1] == "FLOCK":
            major, minor, inode = words[5].split(":")
            found[int(major, 16), int(minor, 16), int(inode)] = int(words[4])
    return found


def lock_holders(directory: Path, prefix: str, held: Held) -> list[int]:
    """Return the processes that hold the names of a prefix; those of other PID namespaces are left out."""
    pids = set()
    for path in directory.glob(f"{prefix}.l.*"):
        with suppress(OSError):
            pids.add(held.get(_key(path), 0))
    return sorted(pid for pid in pids if pid > 0)


def _key(path: Path) -> tuple[int, int, int]:
    status = path.lstat()
    return os.major(status.st_dev), os.minor(status.st_dev), status.st_ino


def lock_of(path: Path) -> Path:
    """Return the lock file of an object."""
    return path.parent / path.name.replace(".t.", ".l.", 1)


def is_held(path: Path, held: Held | None) -> bool | None:
    """Return whether somebody holds an flock on a file; None if the kernel does not tell."""
    if held is None:
        return None
    try:
        return _key(path) in held
    except OSError:
        return False


@dataclass
class _Watched:
    fd: int
    seen: Seen
    first: Snapshot
    last: Snapshot
    moved: set[int] = field(default_factory=set)
    """Reader lines that moved; -1 is the writer's."""

    def look(self) -> None:
        self.last = _snapshot(self.fd)
        before, now = self.first, self.last
        old, new = before.writer, now.writer
        if new.epoch and (new.beat, new.head) != (old.beat, old.head):
            self.moved.add(-1)
        for line, later in zip(before.readers, now.readers, strict=True):
            if later.claim and (later.beat, later.taken) != (line.beat, line.taken):
                self.moved.add(later.index)

    def quiet(self) -> bool:
        """Whether somebody has a claim, and has not been seen to move."""
        claims = {line.index for line in self.last.readers if line.claim}
        if self.last.writer.epoch:
            claims.add(-1)
        return bool(claims - self.moved)

    def patience_s(self) -> float:
        """Return how long a quiet side may be so and live: three of the beats that it promises."""
        promised = [line.beat_ms for line in self.last.readers if line.claim]
        if self.last.writer.epoch:
            promised.append(self.last.writer.beat_ms)
        # What nobody has locked is a dead bridge's; only another container's lock would not be seen.
        unheld = self.seen.held is False
        least, most = (_LEAST_UNHELD_S, _LEAST_UNHELD_S) if unheld else (_LEAST_S, _MOST_S)
        return max((min(most, max(least, 3 * beat / 1000)) for beat in promised), default=0.0)

    def result(self) -> Seen:
        to_plc = self.seen.identity is not None and self.seen.identity.direction is Direction.TO_PLC
        lines = tuple(line for line in self.last.readers if line.index in self.moved)
        return replace(
            self.seen,
            snapshot=self.last,
            bridge_beats=(-1 if to_plc else 0) in self.moved,
            plc_beats=bool(lines) if to_plc else -1 in self.moved,
            plc_lines=lines if to_plc else (),
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
    """Look at every object for as long as it takes to see the sides that live, at most so many ``seconds``.

    Raises OSError if the directory cannot be listed.
    """
    locks: set[Path] = set()
    temporaries: list[Path] = []
    done: list[Seen] = []
    watched: list[_Watched] = []
    try:
        for path in sorted(directory.iterdir()):
            found = _NAME.fullmatch(path.name)
            if found is None or prefix not in (None, found[1]):
                continue
            if found[2] == "l":
                locks.add(path)
            elif found[2] == "n":
                temporaries.append(path)
            else:
                _open(path, found[1], held, done, watched)
        _watch(watched, seconds, sleep)
        done += [each.result() for each in watched]
    finally:
        for each in watched:
            os.close(each.fd)
    objects = tuple(sorted(done, key=lambda seen: seen.path))
    return Objects(objects, frozenset(locks), tuple(temporaries), held is not None)


def _open(path: Path, prefix: str, held: Held | None, done: list[Seen], watched: list[_Watched]) -> None:
    try:
        status = path.lstat()
    except FileNotFoundError:
        return  # removed meanwhile
    topic = Namespace(prefix, path.parent).topic_of(path.name) or path.name
    seen = Seen(path, prefix, topic, status, held=is_held(lock_of(path), held))
    try:
        fd = open_plain_file(path, os.O_RDONLY)
    except ChannelError as error:
        if error.code != "SHM101":
            done.append(replace(seen, error=error))
        return
    try:
        head, size = os.pread(fd, HEADER_SIZE, 0), os.fstat(fd).st_size
        identity = Identity.parse(head, size, where=str(path), accept_retired=True)
        text = os.pread(fd, identity.description_size, identity.description_offset)
        description = Description.from_json(text, str(path))
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
    first = _snapshot(fd)
    watched.append(_Watched(fd, sound, first, first))


def _watch(watched: list[_Watched], seconds: float, sleep: Callable[[float], None]) -> None:
    slept = 0.0
    longest = min(seconds, max((each.patience_s() for each in watched), default=0.0))
    while slept < longest and any(each.quiet() for each in watched):
        sleep(_PAUSE_S)
        slept += _PAUSE_S
        for each in watched:
            each.look()
