"""Who lives, and claiming the lines of who does not: spec/shm-format.md, M6, M7, M9, M14 and M21.

A claim may be replaced once its holder has been silent for long enough, by the clock of whoever wants it. The
classes here take one look per call, for scan cycles; :mod:`rosplc.shm.attach` loops over them.
"""

from __future__ import annotations

import os
import select
from collections.abc import Callable
from pathlib import Path
from typing import TypeVar

from rosplc._core import Reader, Region, Writer
from rosplc.errors import ChannelError
from rosplc.shm.constants import MAX_BEAT_MS, READER_LINE, READER_LINES, WRITER_LINE, reader_line

_T = TypeVar("_T")


def silence_ns(beat_ms: int, factor: int = 3) -> int:
    """Return how long, in ns, a beat may stand still before its claim counts as abandoned (M6, M9)."""
    if beat_ms == 0:
        return 1_000_000_000
    return max(100, factor * min(beat_ms, MAX_BEAT_MS)) * 1_000_000


class Liveness:
    """Judge one peer from its beat and head, both 32-bit words.

    A peer is alive from the first change that is seen until nothing has changed for ``factor`` periods. What
    has not changed since the first look has shown no life. ``period_ms`` 0 counts as a third of a second,
    more than 10 s as 10 s (a damaged word must not keep a dead peer alive for months).
    """

    def __init__(self, period_ms: int, factor: int = 3) -> None:
        self._limit_ns = factor * min(period_ms, MAX_BEAT_MS) * 1_000_000 if period_ms else 1_000_000_000
        self._seen: tuple[int, int] | None = None
        self._changed_ns: int | None = None

    def observe(self, beat: int, head: int, now_ns: int) -> bool:
        """Note the words at ``now_ns`` of a monotonic clock, and return whether the peer lives."""
        if self._seen != (beat, head):
            if self._seen is not None:
                self._changed_ns = now_ns
            self._seen = (beat, head)
        return self._changed_ns is not None and now_ns - self._changed_ns < self._limit_ns


class Peer:
    """The other side of a channel, by the observer's own clock."""

    def __init__(self) -> None:
        self.alive = False  # the beat or the sequence changed within the time that the peer promises
        self.silent = False  # neither did for longer than that. Just after the attach a peer is neither.
        self._beat_ms = -1
        self._liveness = Liveness(0)
        self._since_ns = 0

    def observe(self, beat: int, sequence: int, beat_ms: int, now_ns: int) -> None:
        """Take in the words as they are at ``now_ns``, a monotonic time."""
        if beat_ms != self._beat_ms:
            # Another writer, or the first one after its claim: its own promise counts.
            self._beat_ms, self._liveness = beat_ms, Liveness(beat_ms)
        self.alive = self._liveness.observe(beat, sequence, now_ns)
        if self.alive or self._since_ns == 0:
            self._since_ns = now_ns
        self.silent = now_ns - self._since_ns > silence_ns(beat_ms)


class WriterProcess:
    """Whether the process behind a claim runs; for people, and never a reason to take the claim (M6).

    A process number means nothing in another PID namespace, and the kernel uses it again. So a process is
    taken for the writer's only if it has the object (``device``, ``inode``) mapped writable, and is then
    followed by a pidfd.
    """

    def __init__(self, device: int, inode: int) -> None:
        self._file = f"{os.major(device):02x}:{os.minor(device):02x} {inode} "
        self._seen = (0, 0)
        self._fd = -1

    def runs(self, claim: int, pid: int) -> bool | None:
        """Return whether it runs; None where that is not known, as of another user's process."""
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
        """Follow it no more."""
        fd, self._fd = self._fd, -1
        if fd >= 0:
            os.close(fd)


class _Silence:
    """How long a line has not changed, for one observer."""

    def __init__(self) -> None:
        self._seen: tuple[int, ...] = ()
        self._since_ns = 0

    def lasts(self, words: tuple[int, ...], now_ns: int, limit_ns: int) -> bool:
        if words != self._seen:
            self._seen, self._since_ns = words, now_ns
            return False
        return now_ns - self._since_ns >= limit_ns


class WriterClaim:
    """The attempt to become the writer of a region (M6)."""

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
    """The attempt to get a reader line (M9); ``lines`` are the indices that may be used.

    With ``answer`` it is line 0 of a request or goal object, by one that acts on calls (M27).
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
        """Return whether the reader has a line now; a free one is preferred to a silent one."""
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
        """Return after how long one of the lines must have been silent, if its holder is gone."""
        return max(silence_ns(self._region.words(reader_line(index), 3)[2]) for index in self._lines)

    def attempt_from(self, index: int, expected: int) -> bool:
        """Claim a line from the holder ``expected``; return False if it has another one by now."""

        def claim() -> bool:
            self._reader.claim(index, expected, self._beat_ms, self._task, self._answer)
            return True

        return bool(_unless_claimed(claim))


def _unless_claimed(claim: Callable[[], _T]) -> _T | None:
    """Return None where another was faster (SHM114)."""
    try:
        return claim()
    except ChannelError as error:
        if error.code != "SHM114":
            raise
        return None


def take_over_writer(region: Region, beat_ms: int) -> Writer:
    """Claim the writer's line whoever holds it: for the bridge that holds the name's lock."""
    while True:
        epoch = region.word(WRITER_LINE["writer_epoch"])
        if (writer := _unless_claimed(lambda epoch=epoch: Writer(region, epoch, beat_ms))) is not None:  # type: ignore[misc]
            return writer


def take_over_line(region: Region, reader: Reader, index: int, beat_ms: int, task: str) -> None:
    """Claim a reader line whoever holds it: for the bridge that holds the name's lock."""
    claim = ReaderClaim(region, reader, beat_ms, task, range(index, index + 1))
    while not claim.attempt_from(index, region.word(reader_line(index))):
        pass


def start_of(region: Region, *, latched: bool, line: int | None = None) -> int:
    """Return the ``last`` that a new reader starts from (M14).

    With ``latched``, before everything that the object holds; with ``line``, from that line's ``taken`` if it
    belongs to the object's generation.
    """
    if line is not None:
        at = reader_line(line)
        if region.word(at + READER_LINE["generation"]) == region.generation:
            return region.word(at + READER_LINE["taken"])
    return 0 if latched else region.word(WRITER_LINE["head"])
