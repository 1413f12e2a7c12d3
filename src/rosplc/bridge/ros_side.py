"""The access to ROS: backend, names, settings. Precedence: command line, configuration, environment."""

from __future__ import annotations

import logging
import os
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any, cast

from rosplc.config.file import Config
from rosplc.config.parameters import given_values
from rosplc.config.resolve import OWN_SETTINGS, Plan
from rosplc.model import TypeStore
from rosplc.model.types import MessageType
from rosplc.ros import ROS1, Backend, Choice, RosArguments, choose, open_backend
from rosplc.ros.names import join
from rosplc.ros.parameters import Parameter

log = logging.getLogger("rosplc.bridge")


def choose_backend(config: Config, environment: Mapping[str, str] | None = None) -> Choice:
    """Return the backend that this configuration selects on this machine; ROS001 if ``auto`` finds none."""
    ros = config.settings.ros
    if ros.backend != "auto":
        return Choice(ros.backend, "ros.backend selects it")
    services = bool(config.settings.services or config.settings.actions)
    return choose(ros.distro, environment, zenoh_settings=ros.zenoh is not None, services=services)


@dataclass(frozen=True)
class RosSide:
    """A configuration combined with the ROS arguments of a command line."""

    config: Config
    arguments: RosArguments = field(default_factory=RosArguments)

    def environment(self) -> dict[str, str]:
        """Return the environment for the backend."""
        return {**os.environ, **self.arguments.environment}

    def names(self) -> tuple[str, str, dict[str, str]]:
        """Return the node's base name, its namespace, and topic → topic."""
        settings = self.config.settings
        ros = settings.ros
        name = ros.node_name or "rosplc_" + settings.bridge.replace("-", "_")
        given = self.arguments.for_node(name)
        namespace = ros.namespace
        if "namespace" not in ros.model_fields_set and ros.distro == ROS1:
            namespace = "/" + self.environment().get("ROS_NAMESPACE", "").strip("/")
        remap = dict(given.topics)
        for source, target in ros.remap.items():
            remap.setdefault(source, target)
        return given.node or name, given.namespace or namespace, remap

    def options(self, backend: str) -> dict[str, Any]:
        """Return the backend's own settings."""
        section = getattr(self.config.settings.ros, backend, None) if backend in OWN_SETTINGS else None
        given = {} if section is None else vars(section)
        options: dict[str, Any] = {
            key: value for key, value in given.items() if value is not None and key != "model_fields_set"
        }
        if "config" in options:
            options["config"] = str((self.config.base / options["config"]).absolute())
        if backend == "rclpy":
            arguments = (*options.get("ros_args", ()), *self.arguments.others)
            options = {"ros_args": arguments, "parameter_services": False}  # the bridge serves them
        return options

    def shown(self) -> dict[str, str | list[str]]:
        """Return the values that the bridge's node shows as parameters, besides the version."""
        settings, path = self.config.settings, self.config.path
        shown: dict[str, str | list[str]] = {"bridge": settings.bridge, "topics": list(settings.topics)}
        if path is not None:
            shown["config"] = str(path.absolute())
        return shown if settings.ros.rclpy is None else shown | settings.ros.rclpy.parameters

    def given(self, declared: Iterable[Parameter]) -> dict[str, Any]:
        """Return the command line's values for declared parameters; CFG011 if one is not valid."""
        name, namespace, _ = self.names()
        return given_values(self.arguments.others, join(namespace, name), declared)

    def open(self, store: TypeStore | LiveTypes) -> tuple[Backend, Choice]:
        """Join the ROS graph; return the backend and how it was chosen. Raises as ``open_backend``."""
        environment = self.environment()
        choice = choose_backend(self.config, environment)
        if self.config.settings.ros.backend == "auto":
            log.info("ros.backend: auto selected %s", choice)
        if choice.name != "rclpy" and (unused := self._without_effect()):
            log.warning("the %s backend ignores the ROS arguments %s", choice.name, " ".join(unused))
        name, namespace, remap = self.names()
        backend = open_backend(
            choice.name,
            cast("TypeStore", store),
            name,
            namespace,
            self.config.settings.ros.domain,
            remap=remap,
            environment=environment,
            options=self.options(choice.name),
        )
        return backend, choice

    def _without_effect(self) -> list[str]:
        """Return the arguments that only a ROS client library supports, and not the bridge."""
        others = iter(self.arguments.others)
        return [f"{name} {next(others, '')}" for name in others if name in ("-e", "--enclave")]


class LiveTypes:
    """A type store for a backend whose content can be exchanged at run time."""

    def __init__(self, store: TypeStore) -> None:
        self.store = store  # where types are looked up
        self.used: dict[str, str] = {}  # definition by type name, of the types that a backend has been given

    def use(self, plans: Iterable[Plan]) -> None:
        """Use the type definitions of these topics and services."""
        for layout in (layout for plan in plans for layout in plan.layouts):
            if layout.type_name not in self.used:
                self.used[layout.type_name] = layout.store.definition_text(layout.type_name)

    def __getattr__(self, name: str) -> Any:
        return getattr(self.store, name)

    def __getitem__(self, name: str) -> MessageType:
        """Return a type; TYP001 if it is unknown."""
        return self.store[name]
