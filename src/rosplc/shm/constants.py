"""The numbers of spec/shm-format.md, for whoever generates, draws or reads an object.

Offsets are running sums over the words in the order of the drawing; the assertions tie the
sums to the totals of the spec. Nothing here touches an operating system.
"""

from __future__ import annotations

import enum
from itertools import accumulate
from typing import Final

__all__ = [
    "CHANGING_WORDS",
    "FLAG_FIRST",
    "FLAG_SUBSTITUTED",
    "FLAG_TRUNCATED",
    "FORMAT",
    "HEADER_SIZE",
    "IDENTITY",
    "IDENTITY_SIZE",
    "KIND_TOPIC",
    "LINE_SIZE",
    "MAGIC",
    "MAX_BEAT_MS",
    "MAX_DESCRIPTION_SIZE",
    "MAX_OBJECT_SIZE",
    "MAX_RECORD_SIZE",
    "MAX_RETRIES",
    "MAX_SLOTS",
    "MIN_SLOTS",
    "READER_LINE",
    "READER_LINES",
    "READER_LINES_OFFSET",
    "SLOT_HEADER",
    "SLOT_HEADER_SIZE",
    "STAMP_NONE",
    "STAMP_PLC",
    "STAMP_ROS",
    "STAMP_SYSTEM",
    "STATE_LIVE",
    "STATE_RETIRED",
    "UNKNOWN",
    "VERSION",
    "WRITER_LINE",
    "Direction",
    "reader_line",
]


class Direction(enum.IntEnum):
    """Which way a channel carries messages."""

    TO_PLC = 1
    TO_ROS = 2

    @property
    def word(self) -> str:
        """The word that self-descriptions use: ``"to_plc"`` or ``"to_ros"``."""
        return self.name.lower()


FORMAT: Final = "rosplc 1.0"
MAGIC: Final = 0x434C5052
VERSION: Final = 0x00010000
STATE_LIVE: Final = 1
STATE_RETIRED: Final = 2
KIND_TOPIC: Final = 1
LINE_SIZE: Final = 64
READER_LINES: Final = 4
MIN_SLOTS: Final = 4
MAX_SLOTS: Final = 65536
MAX_RECORD_SIZE: Final = 2**30
MAX_DESCRIPTION_SIZE: Final = 2**20
MAX_OBJECT_SIZE: Final = 2**31 - 1
MAX_RETRIES: Final = 3
MAX_BEAT_MS: Final = 10_000
"""A longer promise counts as this much, lest a damaged word block a claim for days."""

FLAG_FIRST: Final = 1
FLAG_TRUNCATED: Final = 2
FLAG_SUBSTITUTED: Final = 4
STAMP_NONE: Final = 0
STAMP_SYSTEM: Final = 1
STAMP_ROS: Final = 2
STAMP_PLC: Final = 3
UNKNOWN: Final = 0xFFFFFFFF
"""The number of sources or sinks where nobody counts them."""


def _offsets(start: int, total: int, *words: tuple[str, int]) -> dict[str, int]:
    """Name each word's offset; a word comes with its size in bytes."""
    sums = list(accumulate((size for _, size in words), initial=start))
    if sums[-1] != start + total:  # pragma: no cover - found at import
        raise AssertionError(f"the words end at {sums[-1]}, not at {start + total}")
    return {name: offset for (name, _), offset in zip(words, sums, strict=False)}


def _words(*names: str) -> list[tuple[str, int]]:
    return [(name, 4) for name in names]


# Lines 0 and 1.
IDENTITY_SIZE: Final = 2 * LINE_SIZE
IDENTITY: Final = _offsets(
    0,
    IDENTITY_SIZE,
    *_words("magic", "version", "header_size", "state"),
    *_words("features_required", "features_optional", "kind", "direction"),
    *_words("slot_count", "slot_stride", "slot_header_size", "record_size"),
    *_words("slots_offset", "object_size", "description_offset", "description_size"),
    *_words("layout_id_lo", "layout_id_hi", "generation"),
    ("bridge_id", 16),
    *_words("creator_pid", "created_lo", "created_hi", "reader_lines", "identity_crc"),
    ("reserved", 16),
)

# Line 2.
WRITER_LINE: Final = _offsets(
    IDENTITY_SIZE,
    LINE_SIZE,
    *_words("head", "writer_epoch", "writer_beat", "writer_beat_ms"),
    *_words("refused", "truncated", "writer_rule", "sources", "writer_pid", "writer_error"),
    ("reserved", 24),
)

# Lines 3 to 6; these offsets are from the start of a line.
READER_LINES_OFFSET: Final = IDENTITY_SIZE + LINE_SIZE
READER_LINE: Final = _offsets(
    0,
    LINE_SIZE,
    *_words("claim", "beat", "beat_ms", "taken", "layout_lo", "layout_hi"),
    *_words("lost", "retries", "generation", "error", "sinks", "pid"),
    ("task", 16),
)

# Line 7 is reserved.
HEADER_SIZE: Final = READER_LINES_OFFSET + (READER_LINES + 1) * LINE_SIZE

# From the start of a slot.
SLOT_HEADER_SIZE: Final = LINE_SIZE
SLOT_HEADER: Final = _offsets(
    0,
    SLOT_HEADER_SIZE,
    *_words("sequence", "length", "flags", "status", "stamp_lo", "stamp_hi", "stamp_clock", "checksum"),
    *_words("correlation_lo", "correlation_hi"),
    ("client", 16),
    ("reserved", 8),
)

CHANGING_WORDS: Final = (HEADER_SIZE - IDENTITY_SIZE) // 4
"""Control words from the writer's line to the end of the header."""

if HEADER_SIZE != 512:  # pragma: no cover - found at import
    raise AssertionError("the header of version 1.0 has 512 bytes")


def reader_line(index: int) -> int:
    """Return the offset of reader line ``index``, 0 to 3."""
    if not 0 <= index < READER_LINES:
        raise IndexError(f"there is no reader line {index}")
    return READER_LINES_OFFSET + index * LINE_SIZE
