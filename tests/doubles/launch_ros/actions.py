"""launch_ros/actions/lifecycle_node.py, and what it takes of node.py."""

from __future__ import annotations

from typing import Any

from launch import Action


class LifecycleNode(Action):
    def __init__(
        self,
        *,
        name: Any,
        namespace: Any,
        executable: Any,
        package: Any = None,
        parameters: Any = None,
        remappings: Any = None,
        ros_arguments: Any = None,
        arguments: Any = None,
        output: Any = None,
        **kwargs: Any,
    ) -> None:
        super().__init__(**kwargs)
        self.name, self.namespace = name, namespace
        self.executable, self.package, self.parameters = executable, package, parameters
