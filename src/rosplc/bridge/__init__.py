"""A configuration file becomes a running bridge between ROS and the channels."""

from __future__ import annotations

from rosplc.bridge.bind import Binding, bind
from rosplc.bridge.config import Config, json_schema, parse_config, read_config
from rosplc.bridge.engine import Bridge
from rosplc.bridge.problems import ConfigErrors
from rosplc.bridge.resolve import Project, TopicPlan, load_config, load_project, resolve
from rosplc.bridge.run import run_until_signal
from rosplc.bridge.status import BridgeStatus, Level, TopicStatus

__all__ = [
    "Binding",
    "Bridge",
    "BridgeStatus",
    "Config",
    "ConfigErrors",
    "Level",
    "Project",
    "TopicPlan",
    "TopicStatus",
    "bind",
    "json_schema",
    "load_config",
    "load_project",
    "parse_config",
    "read_config",
    "resolve",
    "run_until_signal",
]
