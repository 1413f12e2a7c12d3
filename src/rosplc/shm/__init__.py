"""The channel: a shared-memory object as spec/shm-format.md describes it; a topic has one in each direction.

A bridge opens an :class:`OwnedChannel`; everybody else uses :func:`attach`. This package moves
bytes; what a record means is the business of :mod:`rosplc.layout` and :mod:`rosplc.codec`.
"""

from __future__ import annotations

from rosplc._core import Group as Group
from rosplc._core import Reader as Reader
from rosplc._core import Region as Region
from rosplc._core import SlotInfo as SlotInfo
from rosplc._core import Writer as Writer
from rosplc._core import distance as distance
from rosplc.shm.attach import Attached as Attached
from rosplc.shm.attach import Liveness as Liveness
from rosplc.shm.attach import Peer as Peer
from rosplc.shm.attach import ReaderClaim as ReaderClaim
from rosplc.shm.attach import WriterClaim as WriterClaim
from rosplc.shm.attach import attach as attach
from rosplc.shm.attach import open_object as open_object
from rosplc.shm.calls import Answerer as Answerer
from rosplc.shm.calls import Caller as Caller
from rosplc.shm.calls import GoalNotes as GoalNotes
from rosplc.shm.constants import Direction as Direction
from rosplc.shm.header import Identity as Identity
from rosplc.shm.header import ReaderState as ReaderState
from rosplc.shm.header import Snapshot as Snapshot
from rosplc.shm.header import WriterState as WriterState
from rosplc.shm.names import ACTION as ACTION
from rosplc.shm.names import SERVICE as SERVICE
from rosplc.shm.names import Description as Description
from rosplc.shm.names import Namespace as Namespace
from rosplc.shm.names import Part as Part
from rosplc.shm.owned import OwnedChannel as OwnedChannel
