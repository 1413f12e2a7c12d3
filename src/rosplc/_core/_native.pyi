"""The C core; one section per C file."""

from typing import final

from _typeshed import ReadableBuffer, WriteableBuffer

# ---- py_plan.c: wire bytes to record and back

class Fault(Exception):
    """A message or record was refused.

    ``args`` are four numbers: code (1 to 9: COD001 to COD009), op (index in the plan, 0xFFFFFFFF for
    the message as a whole), size and limit; ``rosplc.codec.Codec.explain`` turns them into words.
    """

    args: tuple[int, int, int, int]

@final
class Plan:
    """A plan that the C core has checked. ``blob`` is what ``rosplc.codec.compile_plan`` makes.

    Raises ValueError if the blob is not a sound plan.
    """

    def __new__(cls, blob: ReadableBuffer, /) -> Plan: ...
    @property
    def record_size(self) -> int:
        """Bytes of a record."""
    @property
    def encoded_bound(self) -> int:
        """The most bytes that a record can take on the wire."""
    def decode(self, data: ReadableBuffer, truncate: bool = False, /) -> tuple[bytes, int]:
        """Return the record and the slot's flags (2: something was cut off). Raises Fault."""
    def decode_into(self, data: ReadableBuffer, out: WriteableBuffer, truncate: bool = False, /) -> int:
        """Fill ``out``, a record, and return the slot's flags. Raises Fault; then ``out`` holds anything."""
    def encode(self, record: ReadableBuffer, /) -> bytes:
        """Return the record as a message. Raises Fault if the record has the wrong size."""
    def encode_into(self, record: ReadableBuffer, out: WriteableBuffer, /) -> int:
        """Write the message to ``out`` and return its size. Raises Fault if ``out`` is too small."""
