"""rosplc: the bridge between ROS and IEC 61131-3 soft-PLCs over POSIX shared memory."""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING

from rosplc._version import __version__

if TYPE_CHECKING:
    from rosplc.api import Channel, attach, include_dir, topics
    from rosplc.bridge.bind import Binding, bind
    from rosplc.bridge.bind_service import bind_action, bind_service
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
    from rosplc.plc.delivery import Delivery
    from rosplc.project import check, generate
    from rosplc.shm import Direction, SlotInfo

__all__ = [
    "BackendError", "Binding", "Channel", "ChannelError", "CodecError", "ConfigError", "ConfigErrors",
    "Delivery", "Direction", "GenerationError", "LayoutError", "MessageTypeError", "ObjectState", "Project",
    "RecordView", "RecordingError", "RosplcError", "SetupError", "SlotInfo", "WebError", "__version__",
    "attach", "bind", "bind_action", "bind_service", "check", "generate", "include_dir", "load_project",
    "topics",
]  # fmt: skip

# Loaded on first use: every module of rosplc imports this one, and most need none of these.
_HOME = {
    name: module
    for module, names in {
        "rosplc.api": "Channel attach include_dir topics",
        "rosplc.bridge.bind": "Binding bind",
        "rosplc.bridge.bind_service": "bind_action bind_service",
        "rosplc.config": "ConfigErrors Project load_project",
        "rosplc.errors": "BackendError ChannelError CodecError ConfigError GenerationError LayoutError "
        "MessageTypeError RecordingError RosplcError SetupError WebError",
        "rosplc.layout": "RecordView",
        "rosplc.monitor": "ObjectState",
        "rosplc.plc.delivery": "Delivery",
        "rosplc.project": "check generate",
        "rosplc.shm": "Direction SlotInfo",
    }.items()
    for name in names.split()
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
