"""The data logger: channels to MCAP files that ROS tools read, and recordings back into channels or ROS."""

import warnings
from typing import Any

from rosplc.recorder.inlet import Selection as Selection
from rosplc.recorder.mcap_file import COMPRESSIONS as COMPRESSIONS
from rosplc.recorder.mcap_file import Compression as Compression
from rosplc.recorder.recorder import Progress as Progress
from rosplc.recorder.recorder import Recorder as Recorder
from rosplc.recorder.recorder import RecordingOptions as RecordingOptions
from rosplc.recorder.recorder import Result as Result
from rosplc.recorder.recorder import quick_process as quick_process
from rosplc.recorder.store import Split as Split


def __getattr__(name: str) -> Any:
    if name == "Order":  # until 0.3
        what = "rosplc.recorder.Order is now rosplc.recorder.RecordingOptions"
        warnings.warn(what, DeprecationWarning, stacklevel=2)
        return RecordingOptions
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
