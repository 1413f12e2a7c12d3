"""Data types, translated expressions, and what the CODESYS libraries in use offer."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TypeAlias

STRING_DEFAULT = 80


@dataclass(frozen=True)
class Elementary:
    """A type with one value; ``kind``: int, bit, bool, real, time."""

    name: str
    kind: str
    bits: int
    signed: bool = False

    @property
    def c(self) -> str:
        """The C type."""
        if self.kind == "real":
            return "float" if self.bits == 32 else "double"
        return f"{'' if self.signed else 'u'}int{self.bits}_t"

    @property
    def integral(self) -> bool:
        """Whether integer arithmetic is allowed."""
        return self.kind in ("int", "bit")


@dataclass(frozen=True)
class String:
    """STRING(n)."""

    length: int


@dataclass(frozen=True)
class Pointer:
    """POINTER TO; target None: ADR's result or 0, which fits every pointer."""

    target: Type | None


@dataclass(frozen=True)
class Array:
    """ARRAY[low..high] OF; several dimensions are nested."""

    low: int
    high: int
    element: Type


@dataclass(frozen=True)
class Struct:
    """A DUT, by its name in capitals."""

    name: str


@dataclass(frozen=True)
class Block:
    """A function block or program."""

    name: str


@dataclass(frozen=True)
class List:
    """A variable list itself, as in ``GVL.x``."""

    name: str


Type: TypeAlias = "Elementary | String | Pointer | Array | Struct | Block | List"

_E = Elementary
BOOL = _E("BOOL", "bool", 8)
BYTE = _E("BYTE", "bit", 8)
ELEMENTARY = {
    t.name: t
    for t in (
        BOOL, BYTE, _E("WORD", "bit", 16), _E("DWORD", "bit", 32), _E("LWORD", "bit", 64),
        _E("SINT", "int", 8, True), _E("INT", "int", 16, True), _E("DINT", "int", 32, True),
        _E("LINT", "int", 64, True), _E("USINT", "int", 8), _E("UINT", "int", 16), _E("UDINT", "int", 32),
        _E("ULINT", "int", 64), _E("REAL", "real", 32), _E("LREAL", "real", 64), _E("TIME", "time", 32),
        _E("LTIME", "time", 64), _E("DT", "time", 32), _E("LDT", "time", 64), _E("DATE", "time", 32),
        _E("TOD", "time", 32),
    )
}  # fmt: skip
ANY_INT = _E("integer literal", "int", 64, True)
ANY_REAL = _E("real literal", "real", 64)
# How a runtime names what has its processor's width; the width is the translation's option.
ALIASES = {
    "__UXINT": ("ULINT", "UDINT"),
    "__XINT": ("LINT", "DINT"),
    "__XWORD": ("LWORD", "DWORD"),
    "RTS_IEC_HANDLE": ("LWORD", "DWORD"),
    "RTS_IEC_RESULT": ("UDINT", "UDINT"),
    "DATE_AND_TIME": ("DT", "DT"),
    "LDATE_AND_TIME": ("LDT", "LDT"),
}


NANOSECONDS = {
    "TIME": 1_000_000, "LTIME": 1, "DT": 1_000_000_000, "LDT": 1, "DATE": 1_000_000_000, "TOD": 1_000_000,
}  # fmt: skip


def fits(value: int, type_: Elementary) -> bool:
    """Whether an integer constant lies within a type's range."""
    if type_.kind == "bool":
        return value in (0, 1)
    low = -(1 << (type_.bits - 1)) if type_.signed else 0
    return low <= value < (1 << (type_.bits - type_.signed))


def smallest(value: int) -> Elementary:
    """Return the smallest integer type that holds a constant."""
    order = ("USINT", "SINT", "UINT", "INT", "UDINT", "DINT", "ULINT", "LINT")
    return next(ELEMENTARY[name] for name in order if fits(value, ELEMENTARY[name]))


def c_declaration(type_: Type, name: str) -> str:
    """Return a C declaration of a variable."""
    if isinstance(type_, Elementary):
        return f"{type_.c} {name}"
    if isinstance(type_, String):
        return f"char {name}[{type_.length + 1}]"
    if isinstance(type_, Pointer):
        # All pointers are bytes in C: CODESYS assigns them across types and counts in bytes.
        return f"uint8_t *{name}"
    if isinstance(type_, Array):
        return c_declaration(type_.element, f"{name}[{type_.high - type_.low + 1}]")
    return f"struct {'D' if isinstance(type_, Struct) else 'B'}_{type_.name} {name}"


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


_ANY = Pointer(None)


@dataclass(frozen=True)
class External:
    """A library function.

    Attributes:
        c: The C function of ``runtime/``.
        parameters: Types as text; ``string`` is VAR_IN_OUT CONSTANT STRING, by reference.
        returns: The result's type as text.
    """

    c: str
    parameters: tuple[str, ...]
    returns: str


def alias(text: str, cpu_bits: int) -> Type:
    """Return the type that a library's declaration names."""
    if text == "pointer":
        return _ANY
    if text == "bytes":
        return Pointer(BYTE)
    if text == "string":
        return String(255)
    if text in ALIASES:
        text = ALIASES[text][0 if cpu_bits == 64 else 1]
    return ELEMENTARY[text]


def constant(name: str, cpu_bits: int) -> tuple[Elementary, int] | None:
    """Return the type and value of a library's constant."""
    if name not in CONSTANTS:
        return None
    type_ = alias(CONSTANTS[name][0], cpu_bits)
    assert isinstance(type_, Elementary)
    return type_, CONSTANTS[name][1] & ((1 << type_.bits) - 1)


CONSTANTS = {"RTS_INVALID_HANDLE": ("RTS_IEC_HANDLE", -1)}

_OPEN = ("string", "__UXINT", "pointer", "pointer")
LIBRARY = {
    "SYSSHAREDMEMORYCREATE": External("SysSharedMemoryCreate", _OPEN, "RTS_IEC_HANDLE"),
    "SYSSHAREDMEMORYOPEN2": External("SysSharedMemoryOpen2", _OPEN, "RTS_IEC_HANDLE"),
    "SYSSHAREDMEMORYGETPOINTER": External(
        "SysSharedMemoryGetPointer", ("RTS_IEC_HANDLE", "pointer"), "bytes"
    ),
    "SYSSHAREDMEMORYCLOSE": External("SysSharedMemoryClose", ("RTS_IEC_HANDLE",), "RTS_IEC_RESULT"),
    "SYSSHAREDMEMORYDELETE": External("SysSharedMemoryDelete", ("RTS_IEC_HANDLE",), "RTS_IEC_RESULT"),
    "SYSSEMPROCESSCREATE": External("SysSemProcessCreate", ("string", "pointer"), "RTS_IEC_HANDLE"),
    "SYSSEMPROCESSENTER": External("SysSemProcessEnter", ("RTS_IEC_HANDLE", "UDINT"), "RTS_IEC_RESULT"),
    "SYSSEMPROCESSLEAVE": External("SysSemProcessLeave", ("RTS_IEC_HANDLE",), "RTS_IEC_RESULT"),
    "SYSSEMPROCESSDELETE": External("SysSemProcessDelete", ("RTS_IEC_HANDLE",), "RTS_IEC_RESULT"),
    "SYSMEMSET": External("SysMemSet", ("pointer", "DINT", "__UXINT"), "bytes"),
    "SYSMEMCPY": External("SysMemCpy", ("pointer", "pointer", "__UXINT"), "bytes"),
    "SYSMEMCMP": External("SysMemCmp", ("pointer", "pointer", "__UXINT"), "DINT"),
    "MEMORYBARRIER.MEMORYBARRIER": External("MemoryBarrier_MemoryBarrier", (), "BOOL"),
    "TIME": External("st_time", (), "TIME"),
    "LTIME": External("st_ltime", (), "LTIME"),
    "__XADD": External("st_xadd", ("pointer", "DINT"), "DINT"),
}
