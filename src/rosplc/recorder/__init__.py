"""The data logger: channels to MCAP files that ROS tools read, and recordings back into channels or ROS."""

from __future__ import annotations

from rosplc.recorder.mcap_write import COMPRESSIONS, Compression
from rosplc.recorder.recorder import Order, Progress, Recorder, Result, quick_process
from rosplc.recorder.selection import Selection
from rosplc.recorder.store import Split

__all__ = [
    "COMPRESSIONS",
    "Compression",
    "Order",
    "Progress",
    "Recorder",
    "Result",
    "Selection",
    "Split",
    "quick_process",
]
