"""A channel reader written from spec/shm-format.md alone, slow and plain: the vectors' second judge.

It shares nothing with the product and nothing with the generator of the vectors.
"""

from __future__ import annotations

import json
import os
import stat
import struct
import zlib
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

__all__ = ["Refused", "StaticReader", "open_object"]

NAMES = [
    *("magic", "version", "header_size", "state", "features_required", "features_optional", "kind"),
    *("direction", "slot_count", "slot_stride", "slot_header_size", "record_size", "slots_offset"),
    *("object_size", "description_offset", "description_size", "layout_id_lo", "layout_id_hi", "generation"),
]


class Refused(Exception):
    """The object is refused with a number of section 9."""

    def __init__(self, number: int) -> None:
        super().__init__(number)
        self.number = number


@dataclass
class Object:
    """An object that passed: its fields and its bytes."""

    fields: dict[str, int]
    data: bytes

    def word(self, offset: int) -> int:
        return int(struct.unpack_from("<I", self.data, offset)[0])

    @property
    def layout_id(self) -> str:
        return self.data[64:72].hex()

    def description(self) -> dict[str, Any]:
        """Read the self-description (check 113)."""
        at, size = self.fields["description_offset"], self.fields["description_size"]
        try:
            members = json.loads(self.data[at : at + size].decode())
            kinds = dict.fromkeys(
                ("format", "topic", "type", "distro", "direction", "layout_id", "bridge", "definition"), str
            )
            good = all(isinstance(members[name], kind) for name, kind in {**kinds, "limits": dict}.items())
            good &= members["format"].startswith("rosplc 1.") and members["direction"] in ("to_plc", "to_ros")
            good &= len(bytes.fromhex(members["layout_id"])) == 8
        except (ValueError, KeyError, TypeError, RecursionError):
            good = False
        if not good:
            raise Refused(113)
        return dict(members)


def open_object(path: Path, expect: dict[str, Any]) -> Object:
    """Open and check an object in the order of section 9."""
    if not os.path.lexists(path):
        raise Refused(101)
    if not stat.S_ISREG(path.lstat().st_mode):
        raise Refused(121)
    size = path.stat().st_size
    with path.open("rb") as file:
        page = file.read(512)
    if len(page) < 512:
        raise Refused(103)
    f = dict(zip(NAMES, struct.unpack_from("<19I", page), strict=True))
    if f["magic"] != int.from_bytes(b"RPLC", "little"):
        raise Refused(104)
    if f["version"] // 65536 != 1:
        raise Refused(105)
    if f["features_required"]:
        raise Refused(106)
    if zlib.crc32(page[0:12] + page[16:108]) != int.from_bytes(page[108:112], "little"):
        raise Refused(107)
    slots, stride, record = f["slot_count"], f["slot_stride"], f["record_size"]
    text_end = f["description_offset"] + f["description_size"]
    consistent = (
        f["header_size"] == 512
        and f["slot_header_size"] == 64
        and int.from_bytes(page[104:108], "little") == 4
        and f["state"] in (1, 2)
        and f["generation"] != 0
        and slots in [2**power for power in range(2, 17)]
        and 1 <= record <= 2**30
        and stride % 64 == 0
        and stride >= 64 + record
        and 2 <= f["description_size"] <= 2**20
        and f["description_offset"] >= 512
        and f["slots_offset"] % 64 == 0
        and f["slots_offset"] >= text_end
        and f["slots_offset"] + slots * stride <= f["object_size"] <= 2**31 - 1
    )
    if not consistent:
        raise Refused(108)
    if size < f["object_size"]:
        raise Refused(109)
    if (
        f["kind"] != expect.get("kind", 1)
        or f["direction"] not in (1, 2)
        or expect.get("direction", f["direction"]) != f["direction"]
    ):
        raise Refused(110)
    if f["state"] != 1:
        raise Refused(111)
    found = Object(f, path.read_bytes())
    if expect.get("layout_id", found.layout_id) != found.layout_id:
        raise Refused(112)
    if expect.get("record_size", record) != record:
        raise Refused(112)
    return found


@dataclass
class StaticReader:
    """Section 7.3 for an object in which nothing moves, one attempt after the other."""

    object: Object
    last: int
    lost: int = 0
    discontinuities: int = 0
    first: bool = field(init=False)

    def __post_init__(self) -> None:
        self.first = self.last == 0

    def take(self, order: str) -> dict[str, Any] | None:
        """Take a message, "newest" or "in_order"; None where nothing is new or acceptable."""
        f = self.object.fields
        n, head = f["slot_count"], self.object.word(128)
        most = n - 3 if self.object.word(152) == 2 else n - 2
        if head in (0, self.last) or (self.last and self._distance(head, self.last) < n):
            return None
        ahead = self._distance(self.last, head)
        if ahead == 0:
            return None
        broken = ahead >= 2**31
        wanted = head
        if order == "in_order" and not broken:
            wanted = self.last + (1 if ahead <= most + 1 else ahead - most)
            if wanted >= 2**32:
                wanted = wanted - 2**32 + n
        for s in (wanted, head):
            # The same slot fails twice under one head that stands still; then the newest is tried.
            at = f["slots_offset"] + s % n * f["slot_stride"]
            sequence, length, flags, _, low, high, clock = struct.unpack_from("<7I", self.object.data, at)
            if sequence == s and length == f["record_size"] and self._distance(s, head) <= most:
                lost = 0 if broken or self.first else self._distance(self.last, s) - 1
                self.lost += lost
                self.discontinuities += broken and not self.first
                self.first = False
                self.last = s
                return {
                    "sequence": s,
                    "lost": lost,
                    "flags": flags,
                    "stamp_ns": high << 32 | low,
                    "stamp_clock": clock,
                    "correlation": struct.unpack_from("<Q", self.object.data, at + 32)[0],
                    "record": self.object.data[at + 64 : at + 64 + length].hex(),
                }
        return None

    def _distance(self, a: int, b: int) -> int:
        return (b - a if b >= a else b - a + 2**32 - self.object.fields["slot_count"]) % 2**32
