"""The codec of one message type: wire bytes to record and back, with errors in words."""

from __future__ import annotations

from typing import TYPE_CHECKING

from rosplc._core import Fault, Plan
from rosplc.codec.compile import Wire, compile_plan
from rosplc.errors import CodecError

if TYPE_CHECKING:
    from _typeshed import ReadableBuffer, WriteableBuffer

    from rosplc.layout import Layout


TRUNCATED = 2  # Bit of the flags: something was cut off to fit (spec/shm-format.md, section 5).


class Codec:
    """Turns messages of one type and wire into records of one layout, and back.

    ``plan`` is what the C core executes; ``publish_wire`` and groups take it. Raises MessageTypeError TYP007
    if the type nests sequences deeper than the executor goes.
    """

    def __init__(self, layout: Layout, wire: Wire) -> None:
        compiled = compile_plan(layout.root, wire)
        self.layout = layout
        self.wire = wire
        self.plan = Plan(compiled.blob)
        self._ops = compiled.ops

    def decode(self, data: ReadableBuffer, *, truncate: bool = False) -> bytes:
        """Return the record of a whole message, for CDR with its 4-byte encapsulation header.

        ``truncate`` cuts strings and sequences that do not fit, instead of refusing the message. Raises
        CodecError COD001 to COD008, with the field's path, the size and the limit.
        """
        try:
            return self.plan.decode(data, truncate)[0]
        except Fault as fault:
            raise self.explain(fault) from None

    def decode_into(self, data: ReadableBuffer, out: WriteableBuffer, *, truncate: bool = False) -> int:
        """Write the record of a message to ``out`` and return its flags (``TRUNCATED`` or 0).

        Every byte of ``out`` is written; after an error it holds anything. Raises CodecError as
        :meth:`decode`; COD009 if ``out`` is not exactly a record long.
        """
        try:
            return self.plan.decode_into(data, out, truncate)
        except Fault as fault:
            raise self.explain(fault) from None

    def encode(self, record: ReadableBuffer) -> bytes:
        """Return the message of a record, little-endian.

        CDR comes with its 4-byte encapsulation header and is padded to a multiple of 4 bytes, as
        DDS wants it. Whatever the record holds gives a message: counts above a capacity read as
        the capacity, a string without NUL has its full capacity, every bool but 0 is 1.

        Raises CodecError: COD009 if ``record`` is not exactly a record long.
        """
        try:
            return self.plan.encode(record)
        except Fault as fault:
            raise self.explain(fault) from None

    def explain(self, fault: Fault | tuple[int, int, int, int]) -> CodecError:
        """Return the error for a fault of this codec's plan, with the field's path, size and limit."""
        number, op, size, limit = fault.args if isinstance(fault, Fault) else fault
        path = self._ops[op].path if op < len(self._ops) else ""
        bound = bool(op < len(self._ops) and self._ops[op].bound and limit == self._ops[op].bound)
        what = _WHAT[number].format(size=size, limit=limit)
        remedy = ""
        if number == 4 and bound:
            what = f"string has {size} bytes, and the type itself allows at most {limit}"
            remedy = "The sender's definition of the type differs; this bound cannot be raised."
        if number == 7 and limit == size - 1 and self.wire is Wire.CDR:
            what = f"string of {size} bytes does not end with a NUL"
        where = f"{self.layout.type_name}: {path}" if path else self.layout.type_name
        return CodecError(f"COD{number:03d}", what, where=where, remedy=remedy)


_WHAT = {
    1: "message ends too early: it has {limit} bytes and needs at least {size}",
    2: "message has {size} bytes, but its content ends so that at most {limit} are possible",
    3: "encapsulation 0x{size:04x} is neither 0x0000 nor 0x0001",
    4: "string has {size} bytes, the limit is {limit}",
    5: "sequence has {size} elements, the limit is {limit}",
    6: "bool has the value {size}",
    7: "string of {size} bytes holds a NUL at byte {limit}",
    8: "sequence has {size} elements, and the type itself allows at most {limit}",
    9: "buffer has {size} bytes instead of {limit}",
}
