"""A read-only look at the counters of an object, for monitors and ``rosplc doctor``."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from rosplc._core import Region
from rosplc.shm.constants import CHANGING_WORDS, IDENTITY, IDENTITY_SIZE, LINE_SIZE, READER_LINES, Direction
from rosplc.shm.header import layout_id_text

_WORDS = LINE_SIZE // 4


@dataclass(frozen=True)
class WriterState:
    """The writer's line (section 3); ``epoch`` 0 means that nobody writes."""

    head: int
    epoch: int
    beat: int
    beat_ms: int
    refused: int
    truncated: int
    rule: int
    sources: int
    pid: int
    error: int


@dataclass(frozen=True)
class ReaderState:
    """A reader line (section 4); ``claim`` 0 means that it is free."""

    index: int
    claim: int
    beat: int
    beat_ms: int
    taken: int
    layout_id: str
    lost: int
    retries: int
    generation: int
    error: int
    sinks: int
    pid: int
    task: str


@dataclass(frozen=True)
class SlotState:
    """What tells a call's message apart (section 11.2)."""

    sequence: int
    status: int
    correlation: int
    reason: int = 0


@dataclass(frozen=True)
class Snapshot:
    """Every counter of an object; each word was loaded with one access, all of them not at once."""

    state: int
    writer: WriterState
    readers: tuple[ReaderState, ...]

    @classmethod
    def of(cls, region: Region, *, free: bool = True) -> Snapshot:
        """Look at a mapped object; ``free`` reader lines can be left out, where hundreds are looked at."""
        words = region.words(IDENTITY_SIZE, CHANGING_WORDS)
        lines = [words[at : at + _WORDS] for at in range(0, len(words), _WORDS)]
        readers = tuple(
            _reader(index, lines[1 + index]) for index in range(READER_LINES) if free or lines[1 + index][0]
        )
        return cls(region.word(IDENTITY["state"]), WriterState(*lines[0][:10]), readers)

    def bridge(self, direction: Direction) -> WriterState | ReaderState | None:
        """Return the bridge's line of an object whose messages go this way; None if it has no claim."""
        if direction is Direction.TO_PLC:
            return self.writer if self.writer.epoch else None
        return next((line for line in self.readers if line.index == 0 and line.claim), None)


def task_name(words: Sequence[int]) -> str:
    """Return the name in the last words of a reader line."""
    name = b"".join(word.to_bytes(4, "little") for word in words).split(b"\0")[0]
    return name.decode("utf-8", "replace")


def _reader(index: int, words: tuple[int, ...]) -> ReaderState:
    claim, beat, beat_ms, taken, low, high, lost, retries, generation, error, sinks, pid = words[:12]
    layout, task = layout_id_text(low, high), task_name(words[12:16])
    return ReaderState(
        index, claim, beat, beat_ms, taken, layout, lost, retries, generation, error, sinks, pid, task
    )
