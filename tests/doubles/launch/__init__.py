"""A stand-in for ROS 2's launch (3.4.3, Jazzy): what a launch file says, kept as it was said.

Signatures follow launch/launch/**/*.py of https://github.com/ros2/launch, branch jazzy; Humble's are
the same for what is here.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any


class Action:
    def __init__(self, *, condition: Any = None) -> None:
        self.condition = condition


class LaunchDescription:
    def __init__(
        self, initial_entities: Iterable[Any] | None = None, *, deprecated_reason: str | None = None
    ) -> None:
        self.entities = list(initial_entities or ())
        assert all(isinstance(entity, Action) for entity in self.entities)
