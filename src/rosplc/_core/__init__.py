"""The C core. Only shm and codec import it; they do so from here, where the import contracts see it."""

from rosplc._core._native import (
    Fault,
    Group,
    Plan,
    Reader,
    Region,
    SlotInfo,
    Writer,
    check_identity,
    distance,
    next_sequence,
)

__all__ = [
    "Fault",
    "Group",
    "Plan",
    "Reader",
    "Region",
    "SlotInfo",
    "Writer",
    "check_identity",
    "distance",
    "next_sequence",
]
