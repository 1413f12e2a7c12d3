"""launch_ros/substitutions/find_package.py."""

from __future__ import annotations

from typing import Any


class FindPackageShare:
    def __init__(self, package: Any) -> None:
        self.package = package
