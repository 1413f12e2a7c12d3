"""The running bridge between ROS and the channels."""

from __future__ import annotations

import warnings
from typing import Any

from rosplc.bridge.bind import Binding, bind
from rosplc.bridge.engine import Bridge
from rosplc.bridge.run import run_until_signal
from rosplc.bridge.status import BridgeStatus, Level, TopicStatus

__all__ = ["Binding", "Bridge", "BridgeStatus", "Level", "TopicStatus", "bind", "run_until_signal"]

_MOVED = (
    "Config", "ConfigErrors", "Project", "TopicPlan", "json_schema", "load_config", "load_project",
    "parse_config", "read_config", "resolve",
)  # fmt: skip


def __getattr__(name: str) -> Any:
    # Until 0.3: the configuration was part of this package.
    if name in _MOVED:
        from rosplc import config

        warnings.warn(f"rosplc.bridge.{name} is now rosplc.config.{name}", DeprecationWarning, stacklevel=2)
        return getattr(config, name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
