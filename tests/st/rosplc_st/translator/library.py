"""What the CODESYS libraries in use offer, and the C functions that stand in for them."""

from __future__ import annotations

from dataclasses import dataclass

from rosplc_st.translator.types import ALIASES, BYTE, ELEMENTARY, Elementary, Pointer, String, Type

__all__ = ["CONSTANTS", "LIBRARY", "External", "alias"]

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
