"""A plan's ops as data, and their binary form; the table of what each does heads ``_core/plan_ops.h``."""

from __future__ import annotations

import enum
import struct
from collections.abc import Sequence
from dataclasses import dataclass

from rosplc.codec.wire import Wire

MAX_LOOPS = 32  # Loops inside loops that the executor runs (`RP_MAX_DEPTH`).

SEQ_OF_BOOL = 1  # Flag of SEQ: the elements are bools.

_HEAD = struct.Struct("<6I")
_OP = struct.Struct("<4B8I")
_MAGIC = int.from_bytes(b"RPLN", "little")


class OpCode(enum.IntEnum):
    """What an op does."""

    COPY = 1
    SWAP = 2
    BOOLS = 3
    ZERO = 4
    SKIP = 5
    STRING = 6
    SEQ = 7
    LOOP = 8
    ARRAY = 9


@dataclass(slots=True)
class Op:
    """One op."""

    code: OpCode  # what it does
    path: str  # the field that it is about, for error messages; not part of the binary form
    at: int = 0  # record offset in bytes, from the start of the record or of the enclosing loop's element
    n: int = 0  # bytes, elements, or capacity, depending on the code
    align: int = 1  # alignment on the wire in bytes
    width: int = 1  # bytes of one number whose bytes are swapped; 1 for none
    flags: int = 0  # ``SEQ_OF_BOOL``
    count_at: int = 0  # record offset of a sequence's count
    stride: int = 0  # bytes from one element to the next
    room: int = 0  # bytes from ``at`` that the op fills, the padding behind it included
    bound: int = 0  # the definition's own bound; 0 for none
    # for loops the number of ops that follow and belong to it; for BOOLS how many bytes before the
    # wire position they begin
    body: int = 0

    def pack(self) -> bytes:
        """Return the op as the C core reads it."""
        return _OP.pack(
            self.code, self.align, self.width, self.flags,
            self.at, self.n, self.count_at, self.stride, self.room, self.bound, self.body, 0,
        )  # fmt: skip


def pack_plan(wire: Wire, record_size: int, native: Sequence[Op], swapped: Sequence[Op]) -> bytes:
    """Return the blob that ``_native.Plan`` loads."""
    head = _HEAD.pack(_MAGIC, wire.value, record_size, len(native), len(swapped), 0)
    return head + b"".join(op.pack() for op in (*native, *swapped))
