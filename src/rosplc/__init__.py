"""rosplc: the bridge between ROS and IEC 61131-3 soft-PLCs over POSIX shared memory."""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING

from rosplc._version import __version__

if TYPE_CHECKING:
    from rosplc.api import Channel, attach, include_dir, topics
    from rosplc.bridge.bind import Binding, bind
    from rosplc.config import ConfigErrors, Project, load_project
    from rosplc.errors import (
        BackendError,
        ChannelError,
        CodecError,
        ConfigError,
        GenerationError,
        LayoutError,
        MessageTypeError,
        RecordingError,
        RosplcError,
        SetupError,
        WebError,
    )
    from rosplc.layout import RecordView
    from rosplc.monitor import ObjectState
    from rosplc.project import Delivery, check, generate
    from rosplc.shm import Direction, SlotInfo

__all__ = [
    "BackendError",
    "Binding",
    "Channel",
    "ChannelError",
    "CodecError",
    "ConfigError",
    "ConfigErrors",
    "Delivery",
    "Direction",
    "GenerationError",
    "LayoutError",
    "MessageTypeError",
    "ObjectState",
    "Project",
    "RecordView",
    "RecordingError",
    "RosplcError",
    "SetupError",
    "SlotInfo",
    "WebError",
    "__version__",
    "attach",
    "bind",
    "check",
    "generate",
    "include_dir",
    "load_project",
    "topics",
]

# Loaded on first use: every module of rosplc imports this one, and most need none of these.
_HOME = {
    "Channel": "rosplc.api",
    "attach": "rosplc.api",
    "include_dir": "rosplc.api",
    "topics": "rosplc.api",
    "Binding": "rosplc.bridge.bind",
    "bind": "rosplc.bridge.bind",
    "ConfigErrors": "rosplc.config",
    "Project": "rosplc.config",
    "load_project": "rosplc.config",
    "BackendError": "rosplc.errors",
    "ChannelError": "rosplc.errors",
    "CodecError": "rosplc.errors",
    "ConfigError": "rosplc.errors",
    "GenerationError": "rosplc.errors",
    "LayoutError": "rosplc.errors",
    "MessageTypeError": "rosplc.errors",
    "RecordingError": "rosplc.errors",
    "RosplcError": "rosplc.errors",
    "SetupError": "rosplc.errors",
    "WebError": "rosplc.errors",
    "RecordView": "rosplc.layout",
    "ObjectState": "rosplc.monitor",
    "Delivery": "rosplc.project",
    "check": "rosplc.project",
    "generate": "rosplc.project",
    "Direction": "rosplc.shm",
    "SlotInfo": "rosplc.shm",
}


def __getattr__(name: str) -> object:
    home = _HOME.get(name)
    if home is None:
        raise AttributeError(f"module 'rosplc' has no attribute {name!r}")
    value: object = getattr(importlib.import_module(home), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
