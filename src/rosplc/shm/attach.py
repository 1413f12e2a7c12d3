"""Opening an object that a bridge created: the state machine of spec/shm-format.md, section 9.

Await the file → check that it is plain and readable → check the identity → map → (claim) → use, until it is
retired; then the caller opens the name again. A claim may be replaced after its holder has been silent for
long enough, by the clock of the new claimant; the classes for this make one check per call.
"""

from __future__ import annotations

import os
import select
import time
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from functools import cached_property
from pathlib import Path
from typing import TypeVar

from rosplc._core import Reader, Region, Writer
from rosplc.errors import ChannelError
from rosplc.shm import constants as spec
from rosplc.shm.constants import READER_LINE, READER_LINES, WRITER_LINE, Direction, reader_line
from rosplc.shm.files import open_plain_file, read_header, refuse_second_name, same_file
from rosplc.shm.header import Identity, SlotState, Snapshot, channel_error
from rosplc.shm.names import Description, Namespace, Part

_T = TypeVar("_T")


def silence_ns(beat_ms: int) -> int:
    """Return how long, in ns, a heartbeat may stay unchanged until its claim counts as abandoned (M6, M9)."""
    return max(_life_ns(beat_ms), spec.MIN_SILENT_MS * 1_000_000)


def _life_ns(beat_ms: int) -> int:
    return (spec.SILENT_BEATS * min(beat_ms, spec.MAX_BEAT_MS) if beat_ms else spec.SILENT_MS) * 1_000_000


class Liveness:
    """Detect whether a peer is alive from its heartbeat and head, both 32-bit words.

    A peer is alive from the first observed change until nothing has changed for three periods. A word that
    has not changed since the first observation is no sign of life. ``period_ms`` 0 counts as a third of a
    second, more than 10 s as 10 s (a damaged word must not keep a dead peer alive for months).
    """

    def __init__(self, period_ms: int) -> None:
        self._limit_ns = _life_ns(period_ms)
        self._seen: tuple[int, int] | None = None
        self._changed_ns: int | None = None

    def observe(self, beat: int, head: int, now_ns: int) -> bool:
        """Note the words at ``now_ns`` of a monotonic clock, and return whether the peer is alive."""
        if self._seen != (beat, head):
            if self._seen is not None:
                self._changed_ns = now_ns
            self._seen = (beat, head)
        return self._changed_ns is not None and now_ns - self._changed_ns < self._limit_ns


class Peer:
    """The other side of a channel, judged by the observer's own clock."""

    def __init__(self) -> None:
        self.alive = False  # the beat or the sequence changed within the time that the peer promises
        self.silent = False  # neither did for longer than that. Just after the attach a peer is neither.
        self._beat_ms = -1
        self._liveness = Liveness(0)
        self._since_ns = 0

    def observe(self, beat: int, sequence: int, beat_ms: int, now_ns: int) -> bool:
        """Note the words at ``now_ns``, a monotonic time; return whether the peer is alive."""
        if beat_ms != self._beat_ms:
            # Another writer, or the first one after its claim: its own promise counts.
            self._beat_ms, self._liveness = beat_ms, Liveness(beat_ms)
        self.alive = self._liveness.observe(beat, sequence, now_ns)
        if self.alive or self._since_ns == 0:
            self._since_ns = now_ns
        self.silent = now_ns - self._since_ns > silence_ns(beat_ms)
        return self.alive


class WriterProcess:
    """Whether the process of a claim is running; for information only, never a reason to replace it (M6).

    A process number is meaningless in another PID namespace, and the kernel reuses numbers. Therefore, a
    process counts as the writer only if it has the object (``device``, ``inode``) mapped writable; then a
    pidfd tracks it.
    """

    def __init__(self, device: int, inode: int) -> None:
        self._file = f"{os.major(device):02x}:{os.minor(device):02x} {inode} "
        self._seen = (0, 0)
        self._fd = -1

    def runs(self, claim: int, pid: int) -> bool | None:
        """Return whether the process is running; None if unknown, such as for another user's process."""
        if (claim, pid) != self._seen:
            self.close()
            self._seen = claim, pid
            try:
                self._fd = os.pidfd_open(pid)
                maps = Path(f"/proc/{pid}/maps").read_text(encoding="utf-8", errors="replace")
                if not any(" rw-s " in line and self._file in line for line in maps.splitlines()):
                    self.close()
            except (OSError, OverflowError, AttributeError):  # no such process, no number, no such call
                self.close()
        if (fd := self._fd) < 0:
            return None
        poll = select.poll()
        poll.register(fd, select.POLLIN)
        return not poll.poll(0)

    def close(self) -> None:
        """Stop tracking the process."""
        fd, self._fd = self._fd, -1
        if fd >= 0:
            os.close(fd)


class _Silence:
    """The time for which a line has not changed, for one observer."""

    def __init__(self) -> None:
        self._seen: tuple[int, ...] = ()
        self._since_ns = 0

    def lasts(self, words: tuple[int, ...], now_ns: int, limit_ns: int) -> bool:
        if words != self._seen:
            self._seen, self._since_ns = words, now_ns
            return False
        return now_ns - self._since_ns >= limit_ns


class WriterClaim:
    """An attempt to become the writer of a region (M6)."""

    def __init__(self, region: Region, beat_ms: int) -> None:
        self._region = region
        self._beat_ms = beat_ms
        self._silence = _Silence()

    def attempt(self, now_ns: int) -> Writer | None:
        """Return the writer, or None while another holds the claim; ``now_ns`` is monotonic."""
        head, epoch, beat, beat_ms = self._region.words(WRITER_LINE["head"], 4)
        if epoch and not self._silence.lasts((head, epoch, beat), now_ns, silence_ns(beat_ms)):
            return None
        return _unless_claimed(lambda: Writer(self._region, epoch, self._beat_ms))


class ReaderClaim:
    """An attempt to claim a reader line (M9); ``lines`` are the indices that may be used.

    With ``answer``, it is line 0 of a request or goal object, for a reader that acts on calls (M27).
    """

    def __init__(
        self, region: Region, reader: Reader, beat_ms: int, task: str, lines: range, *, answer: bool = False
    ) -> None:
        self._answer = answer
        self._region = region
        self._reader = reader
        self._beat_ms = beat_ms
        self._task = task
        self._lines = lines
        self._silences = [_Silence() for _ in range(READER_LINES)]

    def attempt(self, now_ns: int) -> bool:
        """Return whether the reader has a line now; a free line is preferred to a silent one."""
        states = {index: self._region.words(reader_line(index), 3) for index in self._lines}
        for index, (claim, _, _) in states.items():
            if claim == 0 and self.attempt_from(index, 0):
                return True
        for index, (claim, beat, beat_ms) in states.items():
            silent = self._silences[index].lasts((claim, beat), now_ns, silence_ns(beat_ms))
            if silent and self.attempt_from(index, claim):
                return True
        return False

    def patience_ns(self) -> int:
        """Return the longest time until the line of a dead holder counts as silent."""
        return max(silence_ns(self._region.words(reader_line(index), 3)[2]) for index in self._lines)

    def attempt_from(self, index: int, expected: int) -> bool:
        """Claim a line from the holder ``expected``; return False if the line has another holder by now."""

        def claim() -> bool:
            self._reader.claim(index, expected, self._beat_ms, self._task, self._answer)
            return True

        return bool(_unless_claimed(claim))


def _unless_claimed(claim: Callable[[], _T]) -> _T | None:
    """Return None if another claimant was faster (SHM114)."""
    try:
        return claim()
    except ChannelError as error:
        if error.code != "SHM114":
            raise
        return None


def take_over_writer(region: Region, beat_ms: int) -> Writer:
    """Claim the writer's line from any holder; for the bridge that holds the name's lock."""
    while True:
        epoch = region.word(WRITER_LINE["writer_epoch"])
        if (writer := _unless_claimed(lambda epoch=epoch: Writer(region, epoch, beat_ms))) is not None:  # type: ignore[misc]
            return writer


def take_over_line(region: Region, reader: Reader, index: int, beat_ms: int, task: str) -> None:
    """Claim a reader line from any holder; for the bridge that holds the name's lock."""
    claim = ReaderClaim(region, reader, beat_ms, task, range(index, index + 1))
    while not claim.attempt_from(index, region.word(reader_line(index))):
        pass


def start_of(region: Region, *, latched: bool, line: int | None = None) -> int:
    """Return the ``last`` from which a new reader starts (M14).

    With ``latched``, it is before all messages in the object; with ``line``, it is that line's ``taken`` if
    this belongs to the object's generation.
    """
    if line is not None:
        at = reader_line(line)
        if region.word(at + READER_LINE["generation"]) == region.generation:
            return region.word(at + READER_LINE["taken"])
    return 0 if latched else region.word(WRITER_LINE["head"])


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
    """Open an object; None accepts any layout id (16 hexadecimal digits), record size (bytes) or direction.

    ``topic`` is the ROS name, ``client`` one of several uses of a service or action; ``write`` maps it
    writable, to publish or to claim a reader line. Raises ChannelError for the first failing check of section
    9, SHM101 to SHM112 or SHM121; SHM118 if the topic is not valid; SHM123 if the directory cannot be
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
        what = f"the layout id is {found.layout_id}, not {layout_id}"
    elif record_size not in (None, found.record_size):
        what = f"the records have {found.record_size} bytes, not {record_size}"
    if what:
        attached.close()
        raise channel_error(112, what, attached.path)
    return attached


def open_object(path: str) -> Attached:
    """Map an object read-only by its file path, because a shortened name does not contain the topic.

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
    """Raise SHM112 unless the objects of one use contain each other's layout ids (section 11.1)."""
    ids = {part.word: one.identity.layout_id for part, one in found.items()}
    for part, one in found.items():
        others = {word: layout_id for word, layout_id in ids.items() if word != part.word}
        if dict(one.description.partners) != others:
            what = f"its partners' layout ids should be {dict(one.description.partners)}, but are {others}"
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
        """Return the header of the slot that holds a message; None if no slot holds it, or no longer does."""
        identity = self.identity
        at = identity.slots_offset + sequence % identity.slot_count * identity.slot_stride
        words = self.region.words(at, spec.SLOT_HEADER_SIZE // 4)
        if sequence == 0 or not sequence == words[0] == self.region.word(at):
            return None
        return SlotState(words[0], words[3], words[9] << 32 | words[8], words[14])

    def snapshot(self) -> Snapshot:
        """Return the current counters and heartbeats."""
        return Snapshot.of(self.region)

    @abstractmethod
    def close(self) -> None:
        """Give claims back and unmap; a second call does nothing."""

    def __enter__(self: _M) -> _M:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


class Attached(Mapped):
    """An object that another program created."""

    @cached_property
    def description(self) -> Description:
        """The self-description. Raises SHM113 if it cannot be read."""
        text = self.region.read(self.identity.description_offset, self.identity.description_size)
        return Description.from_json(text, str(self.path), Part(self.identity.kind))

    def reader(
        self, task: str = "", *, latched: bool = False, observe: bool = True, beat_ms: int = 1000
    ) -> Reader:
        """Return a new reader, which starts with the next message (M14).

        ``task`` is the reader's name, for display; 15 bytes are kept. ``latched`` starts with the messages in
        the object. With ``observe``, the reader uses no reader line; otherwise, it claims a line that is free
        or has been silent long enough, and observes if there is none (M9). ``beat_ms`` is the longest time
        between two heartbeats or reads that the reader promises. Raises SHM122 if a line is needed and the
        object is mapped read-only; SHM111.
        """
        self.valid()
        reader = Reader(self.region, start_of(self.region, latched=latched))
        if not observe:
            topic = self.identity.kind == Part.TOPIC.value
            first = 0 if topic and self.identity.direction is Direction.TO_PLC else 1
            self._claim_line(reader, beat_ms, task, range(first, READER_LINES))
        self._users.append(reader)
        return reader

    def _claim_line(self, reader: Reader, beat_ms: int, task: str, lines: range) -> None:
        self._writable()
        claim = ReaderClaim(self.region, reader, beat_ms, task, lines)
        began = now = time.monotonic_ns()
        most = claim.patience_ns() + 2 * _LOOK_NS
        # The end counts from the first look: a process that was held up in between looks once more.
        while not claim.attempt(now) and now - began < most:
            time.sleep(_LOOK_NS / 1e9)
            now = time.monotonic_ns()

    def writer_claim(self, beat_ms: int = 1000) -> WriterClaim:
        """Return an attempt to become the writer, for callers that must not wait.

        Raises ChannelError: SHM110 if the direction is to the PLC, where only the bridge writes; SHM122
        if the object is mapped read-only; SHM111.
        """
        if self.identity.direction is not Direction.TO_ROS:
            raise channel_error(110, "only the bridge can write to a to_plc channel", self.path)
        self._writable()
        self.valid()
        return WriterClaim(self.region, beat_ms)

    def writer(self, beat_ms: int = 1000) -> Writer:
        """Claim the channel and return its writer, after waiting until a silent holder has lost its claim.

        ``beat_ms`` is the longest time between two heartbeats or messages that the writer promises. Raises
        SHM114 if another writer is alive; otherwise as :meth:`writer_claim`.
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
                raise channel_error(114, f"process {now.pid} is already the writer", self.path)
            before = now
            time.sleep(_LOOK_NS / 1e9)

    def valid(self) -> None:
        """Raise SHM111 or SHM112 if the object has been retired or damaged; then attach again."""
        self.region.check()

    def still_there(self) -> bool:
        """Return whether the name still refers to this object."""
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
