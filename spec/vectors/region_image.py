"""Building the image of a channel from spec/shm-format.md, without any code of the product.

Offsets are written as the tables of the specification give them, so that a mistake in the
product's tables cannot be repeated here.
"""

from __future__ import annotations

import json
import struct
import zlib
from typing import Any

__all__ = ["LAYOUT_ID", "WORDS", "Image", "record"]

LAYOUT_ID = "0123456789abcdef"
GENERATION = 0x5EED1234
BRIDGE_ID = bytes(range(0xA0, 0xB0))
DEFINITION = "uint64 count\nuint32 word\n"

# spec section 2, then 3; offset 28 is direction.
WORDS = {
    "magic": 0, "version": 4, "header_size": 8, "state": 12, "features_required": 16,
    "features_optional": 20, "kind": 24, "direction": 28, "slot_count": 32, "slot_stride": 36,
    "slot_header_size": 40, "record_size": 44, "slots_offset": 48, "object_size": 52,
    "description_offset": 56, "description_size": 60, "layout_id_lo": 64, "layout_id_hi": 68,
    "generation": 72, "creator_pid": 92, "created_lo": 96, "created_hi": 100, "reader_lines": 104,
    "identity_crc": 108,
    "head": 128, "writer_epoch": 132, "writer_beat": 136, "writer_beat_ms": 140, "refused": 144,
    "truncated": 148, "writer_rule": 152, "sources": 156, "writer_pid": 160, "writer_error": 164,
}  # fmt: skip

LINE = {
    "claim": 0, "beat": 4, "beat_ms": 8, "taken": 12, "layout_lo": 16, "layout_hi": 20, "lost": 24,
    "retries": 28, "generation": 32, "error": 36, "sinks": 40, "pid": 44,
}  # fmt: skip

SLOT = {
    "sequence": 0, "length": 4, "flags": 8, "status": 12, "stamp_lo": 16, "stamp_hi": 20,
    "stamp_clock": 24, "checksum": 28, "correlation_lo": 32, "correlation_hi": 36,
    "client0": 40, "client1": 44, "client2": 48, "client3": 52, "reason": 56,
}  # fmt: skip


def _up(value: int) -> int:
    return (value + 63) // 64 * 64


def record(sequence: int, size: int) -> bytes:
    """Return a record that no other sequence nearby has."""
    return bytes((sequence * 7 + index * 3 + 1) & 0xFF for index in range(size))


class Image:
    """An object's bytes.

    Args:
        slots: N.
        record_size: Bytes of a record.
        direction: 1 towards the PLC, 2 towards ROS.
        description: Members of the self-description that differ from the usual ones.
        text: The self-description's bytes, instead.
        gap: Bytes left free between the self-description and the slots.
        behind: Bytes behind the slots.
    """

    def __init__(
        self,
        *,
        slots: int = 4,
        record_size: int = 12,
        direction: int = 1,
        description: dict[str, Any] | None = None,
        text: bytes | None = None,
        gap: int = 0,
        behind: int = 0,
    ) -> None:
        self.slots, self.record_size, self.direction = slots, record_size, direction
        self.description = {
            "format": "rosplc 1.0",
            "topic": "/v",
            "type": "vector_msgs/msg/Sample",
            "distro": "jazzy",
            "direction": {1: "to_plc", 2: "to_ros"}[direction],
            "limits": {"string": 80, "sequence": 16, "fields": {}},
            "layout_id": LAYOUT_ID,
            "bridge": "cell1",
            "definition": DEFINITION,
            **(description or {}),
        }
        if text is None:
            text = json.dumps(self.description, ensure_ascii=False).encode()
        self.stride = _up(64 + record_size)
        self.slots_offset = _up(512 + len(text)) + _up(gap)
        self.data = bytearray(self.slots_offset + slots * self.stride + behind)
        low, high = struct.unpack("<II", bytes.fromhex(LAYOUT_ID))
        self.set(
            magic=0x434C5052, version=0x10000, header_size=512, state=1, kind=1, direction=direction,
            slot_count=slots, slot_stride=self.stride, slot_header_size=64, record_size=record_size,
            slots_offset=self.slots_offset, object_size=len(self.data), description_offset=512,
            description_size=len(text), layout_id_lo=low, layout_id_hi=high, generation=GENERATION,
            creator_pid=4711, created_lo=0x89ABCDEF, created_hi=0x18000000, reader_lines=4,
        )  # fmt: skip
        self.data[76:92] = BRIDGE_ID
        self.data[512 : 512 + len(text)] = text
        self.set(writer_epoch=0xE0E0, writer_beat=77, writer_beat_ms=1000, writer_rule=1, sources=0xFFFFFFFF)

    def set(self, **words: int) -> Image:
        """Store words by name and give the identity its CRC again."""
        for name, value in words.items():
            struct.pack_into("<I", self.data, WORDS[name], value)
        if "identity_crc" not in words:
            crc = zlib.crc32(self.data[16:108], zlib.crc32(self.data[:12]))
            struct.pack_into("<I", self.data, WORDS["identity_crc"], crc)
        return self

    def line(self, index: int, **words: int) -> Image:
        """Store words of a reader line."""
        for name, value in words.items():
            struct.pack_into("<I", self.data, 192 + 64 * index + LINE[name], value)
        return self

    def slot(self, index: int, **words: int) -> Image:
        """Store words of a slot's header."""
        for name, value in words.items():
            struct.pack_into("<I", self.data, self.slots_offset + index * self.stride + SLOT[name], value)
        return self

    def publish(self, *sequences: int, flags: int = 0, clock: int = 1) -> Image:
        """Put messages into their slots and let ``head`` name the last one."""
        for sequence in sequences:
            message = self.message(sequence, flags=flags, clock=clock)
            stamp, pair = message["stamp_ns"], message["correlation"]
            self.slot(
                sequence % self.slots, sequence=sequence, length=self.record_size, flags=flags,
                stamp_lo=stamp & 0xFFFFFFFF, stamp_hi=stamp >> 32, stamp_clock=clock,
                correlation_lo=pair & 0xFFFFFFFF, correlation_hi=pair >> 32,
            )  # fmt: skip
            at = self.slots_offset + sequence % self.slots * self.stride + 64
            self.data[at : at + self.record_size] = record(sequence, self.record_size)
            self.set(head=sequence)
        return self

    def message(self, sequence: int, *, lost: int = 0, flags: int = 0, clock: int = 1) -> dict[str, Any]:
        """Return what a reader must find under a sequence."""
        return {
            "sequence": sequence,
            "lost": lost,
            "flags": flags,
            "stamp_ns": 1_700_000_000_000_000_000 + sequence * 1_000_003 if clock else 0,
            "stamp_clock": clock,
            "correlation": 0,
            "record": record(sequence, self.record_size).hex(),
        }

    def identity(self) -> dict[str, Any]:
        """Return the identity's fields as an opener must find them."""
        names = (
            "version", "state", "features_optional", "direction", "slot_count", "slot_stride",
            "record_size", "slots_offset", "object_size", "description_offset", "description_size",
            "generation",
        )  # fmt: skip
        found: dict[str, Any] = {name: struct.unpack_from("<I", self.data, WORDS[name])[0] for name in names}
        found["layout_id"] = bytes(self.data[64:72]).hex()
        found["bridge_id"] = bytes(self.data[76:92]).hex()
        return found
