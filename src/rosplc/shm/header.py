"""An object's identity (lines 0 and 1 of spec/shm-format.md, section 2), and snapshots of its other lines.

```
offset 0   magic version header_size state │ features ×2 kind direction
      32   slot_count slot_stride slot_header_size record_size
      48   slots_offset object_size description_offset description_size
      64   layout_id ×2 generation bridge_id×4 creator_pid
      96   created ×2 reader_lines identity_crc │ reserved ×4
```

:meth:`Identity.parse` accepts any bytes and trusts none of them. The C core checks them in the order of
section 9; this module explains the result.
"""

from __future__ import annotations

import struct
import zlib
from dataclasses import dataclass, fields
from functools import lru_cache
from pathlib import Path
from typing import Any

from rosplc._core import Region, check_identity
from rosplc.errors import CODES, ChannelError
from rosplc.shm import constants as spec
from rosplc.shm.constants import Direction, ErrorNumber

_FORMAT = struct.Struct("<19I16s5I16x")
_NAMES = [name for name in spec.IDENTITY if name != "reserved"]
_FIXED = {
    "magic": spec.MAGIC, "header_size": spec.HEADER_SIZE, "features_required": 0,
    "slot_header_size": spec.SLOT_HEADER_SIZE, "reader_lines": spec.READER_LINES, "identity_crc": 0,
}  # fmt: skip
_GEOMETRY = (
    *("header_size", "state", "slot_count", "slot_stride", "slot_header_size", "record_size", "slots_offset"),
    *("object_size", "description_offset", "description_size", "generation", "reader_lines"),
)


def channel_error(number: int, what: str = "", where: Path | str = "") -> ChannelError:
    """Return the ChannelError for a number of section 9; ``what`` defaults to the code's title."""
    code = f"SHM{number:03d}"
    return ChannelError(code, what or CODES[code].title, where=str(where))


def layout_id_words(layout_id: str) -> tuple[int, int]:
    """Return ``layout_id_lo`` and ``layout_id_hi`` of 16 hexadecimal digits; ValueError for other texts."""
    raw = bytes.fromhex(layout_id)
    if len(raw) != 8 or len(layout_id) != 16:
        raise ValueError(f"{layout_id!r} is not a layout id of 16 hexadecimal digits")
    low, high = struct.unpack("<II", raw)
    return low, high


def layout_id_text(low: int, high: int) -> str:
    """Return the 16 hexadecimal digits of two layout id words."""
    return struct.pack("<II", low, high).hex()


def _round_up(value: int) -> int:
    return -(-value // spec.LINE_SIZE) * spec.LINE_SIZE


@dataclass(frozen=True)
class Identity:
    """The identity of an object; sizes and offsets are in bytes from its start."""

    direction: Direction
    slot_count: int
    slot_stride: int
    record_size: int
    slots_offset: int
    object_size: int
    description_offset: int
    description_size: int
    layout_id: str  # the record's layout id, 16 hexadecimal digits
    generation: int
    bridge_id: bytes  # 16 random bytes of the bridge that created the object
    creator_pid: int = 0
    created_ns: int = 0  # creation time, ns since 1970 UTC; for people
    state: int = spec.STATE_LIVE
    version: int = spec.VERSION
    features_optional: int = 0
    kind: int = spec.KIND_TOPIC  # ``Part.value``

    @classmethod
    def plan(
        cls, *, slots: int, record_size: int, description_size: int, behind: int = 0, **others: Any
    ) -> Identity:
        """Lay out a new object: self-description at 512, then the slots, each part on a new line.

        ``behind`` is the number of bytes after the slots.

        Raises ValueError if the number of slots is not a power of two from 4 to 65536, the record does not
        have 1 to 2³⁰ bytes, or the object would exceed 2³¹ - 1 bytes.
        """
        stride = _round_up(spec.SLOT_HEADER_SIZE + record_size)
        start = _round_up(spec.HEADER_SIZE + description_size)
        identity = cls(
            slot_count=slots,
            slot_stride=stride,
            record_size=record_size,
            slots_offset=start,
            object_size=start + slots * stride + behind,
            description_offset=spec.HEADER_SIZE,
            description_size=description_size,
            **others,
        )
        fits = min(slots, record_size, description_size) > 0 and identity.object_size <= spec.MAX_OBJECT_SIZE
        if fits:
            image = identity.build().ljust(spec.HEADER_SIZE, b"\0")
            fits = not check_identity(image, identity.object_size, 0, identity.kind)
        if not fits:
            raise ValueError(
                f"slot_count {slots}, record_size {record_size}, description_size {description_size}, "
                f"object_size {identity.object_size}: slot_count must be a power of two from 4 to "
                f"{spec.MAX_SLOTS}, record_size 1 to {spec.MAX_RECORD_SIZE}, description_size 2 to "
                f"{spec.MAX_DESCRIPTION_SIZE}, object_size at most {spec.MAX_OBJECT_SIZE}"
            )
        return identity

    def build(self) -> bytes:
        """Return lines 0 and 1, 128 bytes, with their CRC."""
        low, high = layout_id_words(self.layout_id)
        words = _FIXED | vars(self) | {"layout_id_lo": low, "layout_id_hi": high}
        words |= {"created_lo": self.created_ns & 0xFFFFFFFF, "created_hi": self.created_ns >> 32}
        words["creator_pid"] &= 0xFFFFFFFF
        image = _FORMAT.pack(*(words[name] for name in _NAMES))
        return image[:108] + struct.pack("<I", _crc(image)) + image[112:]

    @classmethod
    def parse(
        cls,
        first: bytes,
        size: int,
        *,
        direction: Direction | None = None,
        kind: int = spec.KIND_TOPIC,
        where: str = "",
        accept_retired: bool = False,
    ) -> Identity:
        """Check and return the identity in ``first``, a private copy of the first 512 of ``size`` bytes.

        Without ``direction``, both are accepted; ``kind`` 0 accepts all. ``where`` is the path, for messages.
        Raises ChannelError SHM103 to SHM111 for the first check of section 9 that fails; with
        ``accept_retired``, SHM111 is not raised.
        """
        available = size if len(first) >= spec.HEADER_SIZE else len(first)
        number = check_identity(first, available, direction or 0, kind)
        if number and not (number == ErrorNumber.RETIRED and accept_retired):
            raise channel_error(number, _explain(number, first, available, direction, kind), where)
        words = _words(first)
        own = {field.name: words[field.name] for field in fields(cls) if field.name in words}
        own["direction"] = Direction(words["direction"])
        layout_id = layout_id_text(words["layout_id_lo"], words["layout_id_hi"])
        return cls(**own, layout_id=layout_id, created_ns=words["created_hi"] << 32 | words["created_lo"])


def _words(first: bytes) -> dict[str, Any]:
    return dict(zip(_NAMES, _FORMAT.unpack_from(first), strict=True))


def _explain(number: int, first: bytes, size: int, direction: Direction | None, kind: int) -> str:
    """Return what check ``number`` found; empty if the code's title is sufficient."""
    if number == ErrorNumber.TOO_SMALL:
        return f"the object has {size} bytes, but a header has {spec.HEADER_SIZE}"
    found = _words(first)
    version, ours = found["version"], spec.VERSION >> 16
    wanted_way = direction.word if direction is not None else "to_plc or to_ros"
    texts = {
        ErrorNumber.NOT_ROSPLC: f"the magic number is 0x{found['magic']:08X}, not 0x{spec.MAGIC:08X}",
        ErrorNumber.VERSION: f"the format version is {version >> 16}.{version & 0xFFFF}, not {ours}.x",
        ErrorNumber.FEATURES: f"the features 0x{found['features_required']:08X} are required but unknown",
        ErrorNumber.IDENTITY: f"identity_crc is 0x{found['identity_crc']:08X}, not 0x{_crc(first):08X}",
        ErrorNumber.GEOMETRY: "inconsistent: " + ", ".join(f"{name} {found[name]}" for name in _GEOMETRY),
        ErrorNumber.TRUNCATED: f"the object has {size} bytes, but its header states {found['object_size']}",
        ErrorNumber.DIRECTION: f"the kind is {found['kind']} and the direction {found['direction']}, "
        f"not {kind or 'known'} and {wanted_way}",
    }
    return texts.get(ErrorNumber(number), "")


def _crc(image: bytes) -> int:
    # `state` is left out: it changes once.
    return zlib.crc32(image[16:108], zlib.crc32(image[:12]))


if _FORMAT.size != spec.IDENTITY_SIZE:  # pragma: no cover - found at import
    raise AssertionError("the identity has 128 bytes")


_WORDS = spec.LINE_SIZE // 4


@dataclass(frozen=True)
class WriterState:
    """The writer's line (section 3); ``epoch`` 0 means that there is no writer."""

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
    """The data that identifies a message of a call (section 11.2)."""

    sequence: int
    status: int
    correlation: int
    reason: int = 0


@dataclass(frozen=True)
class Snapshot:
    """Every counter of an object; each word is loaded with one access, but not all at the same time."""

    state: int
    writer: WriterState
    readers: tuple[ReaderState, ...]

    @classmethod
    def of(cls, region: Region, *, free: bool = True) -> Snapshot:
        """Take a snapshot of a mapped object; ``free=False`` omits free reader lines to save time."""
        words = region.words(spec.IDENTITY_SIZE, spec.CHANGING_WORDS)
        lines = [words[at : at + _WORDS] for at in range(0, len(words), _WORDS)]
        readers = tuple(
            _reader(index, lines[1 + index])
            for index in range(spec.READER_LINES)
            if free or lines[1 + index][0]
        )
        return cls(region.word(spec.IDENTITY["state"]), WriterState(*lines[0][:10]), readers)

    def bridge(self, direction: Direction) -> WriterState | ReaderState | None:
        """Return the bridge's line of an object with this direction; None if the bridge has no claim."""
        if direction is Direction.TO_PLC:
            return self.writer if self.writer.epoch else None
        return next((line for line in self.readers if line.index == 0 and line.claim), None)


@lru_cache(1024)
def task_name(words: tuple[int, ...]) -> str:
    """Return the task name from the last words of a reader line."""
    name = b"".join(word.to_bytes(4, "little") for word in words).split(b"\0")[0]
    return name.decode("utf-8", "replace")


def _reader(index: int, words: tuple[int, ...]) -> ReaderState:
    claim, beat, beat_ms, taken, low, high, lost, retries, generation, error, sinks, pid = words[:12]
    layout, task = layout_id_text(low, high), task_name(words[12:16])
    return ReaderState(
        index, claim, beat, beat_ms, taken, layout, lost, retries, generation, error, sinks, pid, task
    )
