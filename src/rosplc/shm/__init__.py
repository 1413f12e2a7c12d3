"""The channel: a shared-memory object (spec/shm-format.md) that carries a topic in one direction.

A bridge opens an :class:`OwnedChannel`; all other programs use :func:`attach`. This package transfers
bytes; :mod:`rosplc.layout` and :mod:`rosplc.codec` define the meaning of a record.
"""

from rosplc._core import Group, Reader, Region, Sink, SlotInfo, Writer, beat, distance
from rosplc.shm.attach import Attached, Liveness, Peer, ReaderClaim, WriterClaim, attach, open_object
from rosplc.shm.calls import Answerer, Caller, GoalNotes
from rosplc.shm.constants import Direction
from rosplc.shm.header import Identity, ReaderState, Snapshot, WriterState
from rosplc.shm.names import ACTION, SERVICE, Description, Namespace, Part
from rosplc.shm.owned import OwnedChannel

__all__ = [
    "ACTION", "SERVICE", "Answerer", "Attached", "Caller", "Description", "Direction", "GoalNotes", "Group",
    "Identity", "Liveness", "Namespace", "OwnedChannel", "Part", "Peer", "Reader", "ReaderClaim",
    "ReaderState", "Region", "Sink", "SlotInfo", "Snapshot", "Writer", "WriterClaim", "WriterState", "attach",
    "beat", "distance", "open_object",
]  # fmt: skip
