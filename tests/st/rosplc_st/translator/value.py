"""A translated expression."""

from __future__ import annotations

from dataclasses import dataclass

from rosplc_st.translator.types import Type

__all__ = ["Value", "c_string"]


@dataclass(frozen=True)
class Value:
    """A translated expression.

    Attributes:
        code: The C expression.
        type: Its type; ANY_INT and ANY_REAL for literals.
        constant: The value, where it is known.
        place: It has an address.
        shared: It was reached through a pointer: accesses happen as often as written, in order.
        readonly: Nothing may be assigned, and why.
        calls: It contains calls, so that the order of evaluation matters.
    """

    code: str
    type: Type | None
    constant: int | float | None = None
    place: bool = False
    shared: bool = False
    readonly: str = ""
    calls: bool = False


def c_string(data: bytes) -> str:
    """Return a C string literal."""
    return (
        '"'
        + "".join(f"\\{byte:03o}" if not 32 <= byte < 127 or byte in b'"\\?' else chr(byte) for byte in data)
        + '"'
    )
