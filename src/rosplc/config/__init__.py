"""A configuration file becomes validated settings and a plan for each topic."""

from __future__ import annotations

from rosplc.config.file import Config as Config
from rosplc.config.file import json_schema as json_schema
from rosplc.config.file import parse_config as parse_config
from rosplc.config.file import read_config as read_config
from rosplc.config.resolve import Project as Project
from rosplc.config.resolve import TopicPlan as TopicPlan
from rosplc.config.resolve import load_config as load_config
from rosplc.config.resolve import load_project as load_project
from rosplc.config.resolve import resolve as resolve
from rosplc.config.yaml_source import ConfigErrors as ConfigErrors
