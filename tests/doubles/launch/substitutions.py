"""launch/substitutions."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any


class LaunchConfiguration:
    def __init__(self, variable_name: Any, *, default: Any = None) -> None:
        self.name = variable_name


class PathJoinSubstitution:
    def __init__(self, substitutions: Iterable[Any]) -> None:
        self.parts = list(substitutions)
