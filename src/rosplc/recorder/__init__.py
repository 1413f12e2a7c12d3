"""The data logger: records channels to MCAP files for ROS tools, and replays them into channels or ROS."""

import warnings
from typing import Any

from rosplc.recorder.inlet import Selection
from rosplc.recorder.mcap_file import COMPRESSIONS, Compression
from rosplc.recorder.recorder import Progress, Recorder, RecordingOptions, Result, quick_process
from rosplc.recorder.store import Split

__all__ = [
    "COMPRESSIONS", "Compression", "Progress", "Recorder", "RecordingOptions", "Result", "Selection",
    "Split", "quick_process",
]  # fmt: skip


def __getattr__(name: str) -> Any:
    if name == "Order":  # until 0.3
        what = "rosplc.recorder.Order is now rosplc.recorder.RecordingOptions"
        warnings.warn(what, DeprecationWarning, stacklevel=2)
        return RecordingOptions
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
