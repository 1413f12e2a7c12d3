"""The identity of an object: lines 0 and 1 of spec/shm-format.md, section 2.

```
offset 0   magic version header_size state │ features ×2 kind direction
      32   slot_count slot_stride slot_header_size record_size
      48   slots_offset object_size description_offset description_size
      64   layout_id ×2 generation bridge_id×4 creator_pid
      96   created ×2 reader_lines identity_crc │ reserved ×4
```

:meth:`Identity.parse` takes any bytes and trusts none of them; it checks in the order of
section 9. The C core repeats the checks when it maps an object.
"""

from __future__ import annotations

import struct
import zlib
from dataclasses import dataclass

from rosplc.errors import CODES, ChannelError
from rosplc.shm.constants import (
    HEADER_SIZE,
    IDENTITY_SIZE,
    KIND_TOPIC,
    LINE_SIZE,
    MAGIC,
    MAX_DESCRIPTION_SIZE,
    MAX_OBJECT_SIZE,
    MAX_RECORD_SIZE,
    MAX_SLOTS,
    MIN_SLOTS,
    READER_LINES,
    SLOT_HEADER_SIZE,
    STATE_LIVE,
    STATE_RETIRED,
    VERSION,
    Direction,
)

__all__ = ["Identity", "channel_error", "layout_id_text", "layout_id_words"]

_FORMAT = struct.Struct("<19I16s5I16x")


def channel_error(number: int, what: str = "", where: str = "") -> ChannelError:
    """Return the ChannelError of a number of section 9; ``what`` defaults to the code's title."""
    code = f"SHM{number:03d}"
    return ChannelError(code, what or CODES[code].title, where=where)


def layout_id_words(layout_id: str) -> tuple[int, int]:
    """Return the words ``layout_id_lo`` and ``layout_id_hi`` of 16 hexadecimal digits.

    Raises:
        ValueError: If it is anything else.
    """
    raw = bytes.fromhex(layout_id)
    if len(raw) != 8 or len(layout_id) != 16:
        raise ValueError(f"a layout id has 16 hexadecimal digits, not {layout_id!r}")
    low, high = struct.unpack("<II", raw)
    return low, high


def layout_id_text(low: int, high: int) -> str:
    """Return the 16 hexadecimal digits of two layout id words."""
    return struct.pack("<II", low, high).hex()


def _round_up(value: int) -> int:
    return -(-value // LINE_SIZE) * LINE_SIZE


@dataclass(frozen=True)
class Identity:
    """What an object is; sizes and offsets are bytes from its start.

    Attributes:
        layout_id: The record's layout id, 16 hexadecimal digits.
        bridge_id: 16 random bytes of the bridge that created the object.
        created_ns: Creation time, ns since 1970 UTC; for people.
    """

    direction: Direction
    slot_count: int
    slot_stride: int
    record_size: int
    slots_offset: int
    object_size: int
    description_offset: int
    description_size: int
    layout_id: str
    generation: int
    bridge_id: bytes
    creator_pid: int = 0
    created_ns: int = 0
    state: int = STATE_LIVE
    version: int = VERSION
    features_optional: int = 0

    @classmethod
    def plan(
        cls,
        *,
        direction: Direction,
        slots: int,
        record_size: int,
        description_size: int,
        layout_id: str,
        generation: int,
        bridge_id: bytes,
        creator_pid: int = 0,
        created_ns: int = 0,
    ) -> Identity:
        """Lay out a new object: self-description at 512, then the slots, each part on a new line.

        Raises:
            ValueError: If the number of slots is no power of two from 4 to 65536, the record is not
                of 1 to 2³⁰ bytes, or the object would exceed 2³¹ - 1 bytes.
        """
        stride = _round_up(SLOT_HEADER_SIZE + record_size)
        start = _round_up(HEADER_SIZE + description_size)
        identity = cls(
            direction=direction,
            slot_count=slots,
            slot_stride=stride,
            record_size=record_size,
            slots_offset=start,
            object_size=start + slots * stride,
            description_offset=HEADER_SIZE,
            description_size=description_size,
            layout_id=layout_id,
            generation=generation,
            bridge_id=bridge_id,
            creator_pid=creator_pid,
            created_ns=created_ns,
        )
        reason = identity._inconsistency()
        if reason:
            raise ValueError(reason)
        return identity

    @property
    def layout_words(self) -> tuple[int, int]:
        """The layout id as the words ``layout_id_lo`` and ``layout_id_hi``."""
        return layout_id_words(self.layout_id)

    def build(self) -> bytes:
        """Return lines 0 and 1, 128 bytes, with their CRC."""
        image = _FORMAT.pack(
            MAGIC,
            self.version,
            HEADER_SIZE,
            self.state,
            0,
            self.features_optional,
            KIND_TOPIC,
            self.direction,
            self.slot_count,
            self.slot_stride,
            SLOT_HEADER_SIZE,
            self.record_size,
            self.slots_offset,
            self.object_size,
            self.description_offset,
            self.description_size,
            *self.layout_words,
            self.generation,
            self.bridge_id,
            self.creator_pid & 0xFFFFFFFF,
            self.created_ns & 0xFFFFFFFF,
            self.created_ns >> 32,
            READER_LINES,
            0,
        )
        return image[:108] + struct.pack("<I", _crc(image)) + image[112:]

    @classmethod
    def parse(
        cls,
        first: bytes,
        size: int,
        *,
        direction: Direction | None = None,
        where: str = "",
        accept_retired: bool = False,
    ) -> Identity:
        """Check and return the identity in the first bytes of an object of ``size`` bytes.

        Args:
            first: A private copy of the object's first 512 bytes.
            size: Bytes of the whole object.
            direction: The direction expected; None accepts both.
            where: The object's path, for messages.
            accept_retired: Return a retired object's identity instead of raising SHM111.

        Raises:
            ChannelError: SHM103 to SHM111, the first of section 9 that fails.
        """
        if size < HEADER_SIZE or len(first) < HEADER_SIZE:
            raise channel_error(
                103, f"object has {min(size, len(first))} bytes, a header has {HEADER_SIZE}", where
            )
        words = _FORMAT.unpack_from(first)
        (magic, version, header_size, state, required, optional, kind, way) = words[:8]
        (count, stride, slot_header, record, start, total, text_at, text_size) = words[8:16]
        (low, high, generation, bridge_id, pid, created_lo, created_hi, lines, crc) = words[16:]
        if magic != MAGIC:
            raise channel_error(104, f"magic is 0x{magic:08X}, not 0x{MAGIC:08X}", where)
        if version >> 16 != VERSION >> 16:
            raise channel_error(105, f"format version is {version >> 16}.{version & 0xFFFF}, not 1.x", where)
        if required:
            raise channel_error(106, f"features 0x{required:08X} are required and unknown", where)
        if crc != _crc(first):
            raise channel_error(107, f"identity_crc is 0x{crc:08X}, not 0x{_crc(first):08X}", where)
        for name, found, wanted in (
            ("header_size", header_size, HEADER_SIZE),
            ("slot_header_size", slot_header, SLOT_HEADER_SIZE),
            ("reader_lines", lines, READER_LINES),
        ):
            if found != wanted:
                raise channel_error(108, f"{name} is {found}, not {wanted}", where)
        if state not in (STATE_LIVE, STATE_RETIRED) or generation == 0:
            raise channel_error(108, f"state is {state} and generation {generation}", where)
        identity = cls(
            direction=Direction(way) if way in (1, 2) else Direction.TO_PLC,
            slot_count=count,
            slot_stride=stride,
            record_size=record,
            slots_offset=start,
            object_size=total,
            description_offset=text_at,
            description_size=text_size,
            layout_id=layout_id_text(low, high),
            generation=generation,
            bridge_id=bridge_id,
            creator_pid=pid,
            created_ns=created_hi << 32 | created_lo,
            state=state,
            version=version,
            features_optional=optional,
        )
        reason = identity._inconsistency()
        if reason:
            raise channel_error(108, reason, where)
        if size < total:
            raise channel_error(109, f"object has {size} bytes and says {total}", where)
        if kind != KIND_TOPIC or way not in (1, 2) or (direction is not None and way != direction):
            wanted_way = direction.word if direction is not None else "to_plc or to_ros"
            raise channel_error(110, f"kind is {kind} and direction {way}, not 1 and {wanted_way}", where)
        if state != STATE_LIVE and not accept_retired:
            raise channel_error(111, where=where)
        return identity

    def _inconsistency(self) -> str:
        """Say which inequality of section 2 fails; empty if none does."""
        if not MIN_SLOTS <= self.slot_count <= MAX_SLOTS or self.slot_count & (self.slot_count - 1):
            return f"slot_count is {self.slot_count}, not a power of two from {MIN_SLOTS} to {MAX_SLOTS}"
        if not 1 <= self.record_size <= MAX_RECORD_SIZE:
            return f"record_size is {self.record_size}, not 1 to {MAX_RECORD_SIZE}"
        if self.slot_stride % LINE_SIZE or self.slot_stride < SLOT_HEADER_SIZE + self.record_size:
            return f"slot_stride is {self.slot_stride} for records of {self.record_size} bytes"
        if not 2 <= self.description_size <= MAX_DESCRIPTION_SIZE:
            return f"description_size is {self.description_size}, not 2 to {MAX_DESCRIPTION_SIZE}"
        if self.description_offset < HEADER_SIZE:
            return f"description_offset is {self.description_offset}, inside the header"
        if (
            self.slots_offset % LINE_SIZE
            or self.slots_offset < self.description_offset + self.description_size
        ):
            return f"slots_offset is {self.slots_offset}"
        if not self.slots_offset + self.slot_count * self.slot_stride <= self.object_size <= MAX_OBJECT_SIZE:
            return f"object_size is {self.object_size}, its slots need {self.slot_count * self.slot_stride}"
        return ""


def _crc(image: bytes) -> int:
    # `state` is left out: it changes once.
    return zlib.crc32(image[16:108], zlib.crc32(image[:12]))


if _FORMAT.size != IDENTITY_SIZE:  # pragma: no cover - found at import
    raise AssertionError("the identity has 128 bytes")
