"""The channel: a shared-memory object as spec/shm-format.md describes it; a topic has one in each direction.

A bridge opens an :class:`OwnedChannel`; everybody else uses :func:`attach`. This package moves
bytes; what a record means is the business of :mod:`rosplc.layout` and :mod:`rosplc.codec`.
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
