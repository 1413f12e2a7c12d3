"""Functions that a technician expects beside the messages: times, angles, handshake."""

from __future__ import annotations

from rosplc.model import TypeStore
from rosplc.plc.project import Pou
from rosplc.plc.types import DutBuilder

__all__ = ["helper_objects"]


def helper_objects(store: TypeStore, builder: DutBuilder, folder: str) -> tuple[Pou, ...]:
    """Return the helper functions and blocks."""
    return ()
