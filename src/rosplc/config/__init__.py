"""A configuration file becomes validated settings and a plan for each topic."""

from rosplc.config.file import Config, json_schema, parse_config, read_config
from rosplc.config.resolve import Project, TopicPlan, load_config, load_project, resolve
from rosplc.config.yaml_source import ConfigErrors

__all__ = [
    "Config", "ConfigErrors", "Project", "TopicPlan", "json_schema", "load_config", "load_project",
    "parse_config", "read_config", "resolve",
]  # fmt: skip
