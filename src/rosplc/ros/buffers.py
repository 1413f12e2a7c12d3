"""The largest message that fits into a UDP receive buffer: one rule for the log and ``rosplc doctor``."""

from __future__ import annotations

from pathlib import Path

_CYCLONE = 1 << 20  # bytes that Cyclone DDS asks for where the default is smaller
_CORE = Path("proc/sys/net/core")


def default_buffer(root: Path = Path("/")) -> int:
    """Return the buffer size of a socket with default settings, as in Fast DDS; 0 if unknown."""
    return _number(root / _CORE / "rmem_default")


def cyclone_buffer(root: Path = Path("/")) -> int:
    """Return the buffer size of Cyclone DDS's sockets; 0 if unknown."""
    default, most = default_buffer(root), _number(root / _CORE / "rmem_max")
    # The kernel doubles what a program asks for, within rmem_max (socket(7), SO_RCVBUF).
    return default if default >= _CYCLONE else max(default, 2 * min(_CYCLONE, most)) if most else 0


def largest_message(buffer: int) -> int:
    """Return the size of the largest message that fits into a buffer as one burst of packets.

    The buffer also holds the kernel's bookkeeping: of 212,992 bytes, 176,640 held data in packets of 14,720
    bytes, Cyclone's largest (measured over loopback).
    """
    return buffer * 4 // 5


def _number(path: Path) -> int:
    try:
        return int(path.read_text(encoding="ascii"))
    except (OSError, ValueError):
        return 0
