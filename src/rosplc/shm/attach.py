"""Opening an object that a bridge made: the state machine of spec/shm-format.md, section 9.

await the file → plain and readable → identity agrees → map → (claim) → use, until it is retired; then the
caller opens the name again.
"""

from __future__ import annotations

import os
import time
from abc import ABC, abstractmethod
from collections.abc import Mapping
from functools import cached_property
from pathlib import Path
from typing import TypeVar

from rosplc._core import Reader, Region, Writer
from rosplc.shm import constants as spec
from rosplc.shm.claims import ReaderClaim, WriterClaim, WriterProcess, start_of
from rosplc.shm.constants import READER_LINES, Direction
from rosplc.shm.files import open_plain_file, read_header, refuse_second_name, same_file
from rosplc.shm.header import Identity, SlotState, Snapshot, channel_error
from rosplc.shm.names import Description, Namespace, Part

_LOOK_NS = 5_000_000
_M = TypeVar("_M", bound="Mapped")


def attach(
    namespace: Namespace,
    topic: str,
    *,
    layout_id: str | None = None,
    record_size: int | None = None,
    direction: Direction | None = None,
    write: bool = False,
    part: Part = Part.TOPIC,
    client: str = "",
) -> Attached:
    """Open an object; None accepts any layout id (16 hexadecimal digits), record size (bytes) and direction.

    ``topic`` is as ROS writes it, ``client`` one of several uses of a service or action; ``write`` maps it
    writable, to publish or to claim a reader line. Raises ChannelError: the first check of section 9 that
    fails, SHM101 to SHM112 or SHM121; SHM118 if the topic is not valid; SHM123 if the directory cannot be
    used.
    """
    path = namespace.path(topic, part, client)
    fd = open_plain_file(path, os.O_RDWR if write else os.O_RDONLY)
    try:
        if write:
            refuse_second_name(fd, path)
        attached = Attached(fd, path, direction, write, part)
    finally:
        os.close(fd)
    found = attached.identity
    what = ""
    if layout_id not in (None, found.layout_id):
        what = f"layout id is {found.layout_id}, {layout_id} is expected"
    elif record_size not in (None, found.record_size):
        what = f"records have {found.record_size} bytes, not {record_size}"
    if what:
        attached.close()
        raise channel_error(112, what, attached.path)
    return attached


def open_object(path: str) -> Attached:
    """Map an object read-only, by its file: a shortened name does not give its topic away.

    Raises ChannelError as :func:`attach`.
    """
    name = Path(path).name
    part = Namespace(name.partition(".")[0]).part_of(name) or Part.TOPIC
    fd = open_plain_file(Path(path), os.O_RDONLY)
    try:
        return Attached(fd, Path(path), None, False, part)
    finally:
        os.close(fd)


def belong_together(found: Mapping[Part, Attached]) -> None:
    """Raise SHM112 unless the objects of one use name each other's layout ids (section 11.1)."""
    ids = {part.word: one.identity.layout_id for part, one in found.items()}
    for part, one in found.items():
        others = {word: layout_id for word, layout_id in ids.items() if word != part.word}
        if dict(one.description.partners) != others:
            what = f"it belongs to {dict(one.description.partners)}, not to {others}"
            raise channel_error(112, what, one.path)


class Mapped(ABC):
    """A mapped object; a context manager that closes it."""

    def __init__(
        self, fd: int, path: Path, direction: Direction | None, write: bool, part: Part = Part.TOPIC
    ) -> None:
        self.path = path
        self._first, size = read_header(fd)
        # the validated private copy of lines 0 and 1
        self.identity = Identity.parse(
            self._first, size, direction=direction, kind=part.value, where=str(path)
        )
        self.region = Region(fd, self._first, write, str(path))  # the mapping
        status = os.fstat(fd)
        self._file = (status.st_dev, status.st_ino)
        self.process = WriterProcess(*self._file)  # the process that writes it
        self._users: list[Reader | Writer] = []

    def slot(self, sequence: int) -> SlotState | None:
        """Return the header of the slot that holds a message; None if no slot holds it (any more)."""
        identity = self.identity
        at = identity.slots_offset + sequence % identity.slot_count * identity.slot_stride
        words = self.region.words(at, spec.SLOT_HEADER_SIZE // 4)
        if sequence == 0 or not sequence == words[0] == self.region.word(at):
            return None
        return SlotState(words[0], words[3], words[9] << 32 | words[8], words[14])

    def snapshot(self) -> Snapshot:
        """Return all counters and beats as they are now."""
        return Snapshot.of(self.region)

    @abstractmethod
    def close(self) -> None:
        """Give claims back and unmap; a second call does nothing."""

    def __enter__(self: _M) -> _M:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


class Attached(Mapped):
    """An object that somebody else has made."""

    @cached_property
    def description(self) -> Description:
        """The self-description. Raises SHM113 if it cannot be read."""
        text = self.region.read(self.identity.description_offset, self.identity.description_size)
        return Description.from_json(text, str(self.path), Part(self.identity.kind))

    def reader(
        self, task: str = "", *, latched: bool = False, observe: bool = True, beat_ms: int = 1000
    ) -> Reader:
        """Return a new reader, which has taken nothing and starts with the next message (M14).

        ``task`` is its name, shown to people; 15 bytes are kept. ``latched`` starts with what the object
        holds already. With ``observe`` it uses no reader line; otherwise it claims one that is free, or
        silent within its time, and observes where there is none (M9). ``beat_ms`` is the longest time between
        two beats, or takings, that it promises. Raises SHM122 if a line is wanted and the object is mapped
        read-only; SHM111.
        """
        self.valid()
        reader = Reader(self.region, start_of(self.region, latched=latched))
        if not observe:
            topic = self.identity.kind == Part.TOPIC.value
            first = 0 if topic and self.identity.direction is Direction.TO_PLC else 1
            self._claim_line(reader, beat_ms, task, range(first, READER_LINES))
        self._users.append(reader)
        return reader

    def acting_reader(self, task: str = "", *, beat_ms: int = 1000) -> Reader:
        """Return the reader of a service's or action's object that acts on its messages (section 11.1).

        Raises ChannelError: SHM114 if another one lives; SHM110 if the bridge acts on them; SHM122; SHM111.
        """
        if self.identity.direction is not Direction.TO_PLC:
            raise channel_error(110, "only the bridge acts on what the PLC writes", self.path)
        self.valid()
        reader = Reader(self.region, start_of(self.region, latched=False))
        answer = Part(self.identity.kind).asks
        if not self._claim_line(reader, beat_ms, task, range(1), answer=answer):
            raise channel_error(114, where=self.path)
        self._users.append(reader)
        return reader

    def _claim_line(
        self, reader: Reader, beat_ms: int, task: str, lines: range, *, answer: bool = False
    ) -> bool:
        self._writable()
        claim = ReaderClaim(self.region, reader, beat_ms, task, lines, answer=answer)
        began = now = time.monotonic_ns()
        most = claim.patience_ns() + 2 * _LOOK_NS
        # The end counts from the first look: a process that was held up in between looks once more.
        while not (claimed := claim.attempt(now)) and now - began < most:
            time.sleep(_LOOK_NS / 1e9)
            now = time.monotonic_ns()
        return claimed

    def writer_claim(self, beat_ms: int = 1000) -> WriterClaim:
        """Return an attempt to become the writer, for callers that must not wait.

        Raises ChannelError: SHM110 if the direction is towards the PLC, where only the bridge writes; SHM122
        if the object is mapped read-only; SHM111.
        """
        if self.identity.direction is not Direction.TO_ROS:
            raise channel_error(110, "only the bridge writes towards the PLC", self.path)
        self._writable()
        self.valid()
        return WriterClaim(self.region, beat_ms)

    def writer(self, beat_ms: int = 1000) -> Writer:
        """Claim the channel and return its writer, waiting until a silent holder has lost its claim.

        ``beat_ms`` is the longest time between two beats, or messages, that the writer promises. Raises
        SHM114 if another writer lives; else as :meth:`writer_claim`.
        """
        claim = self.writer_claim(beat_ms)
        before = self.snapshot().writer
        while True:
            writer = claim.attempt(time.monotonic_ns())
            if writer is not None:
                self._users.append(writer)
                return writer
            now = self.snapshot().writer
            if now.epoch == before.epoch and (now.beat, now.head) != (before.beat, before.head):
                raise channel_error(114, f"process {now.pid} writes it", self.path)
            before = now
            time.sleep(_LOOK_NS / 1e9)

    def valid(self) -> None:
        """Raise SHM111 or SHM112 if the object has been retired or damaged; then attach again."""
        self.region.check()

    def still_there(self) -> bool:
        """Return whether the name still leads to this object."""
        return same_file(self.path, *self._file)

    def close(self) -> None:
        """Give claims back and unmap; a second call does nothing."""
        for user in self._users:
            user.release()
        self._users.clear()
        self.process.close()
        self.region.close()

    def _writable(self) -> None:
        if not self.region.writable:
            raise channel_error(122, where=self.path)
