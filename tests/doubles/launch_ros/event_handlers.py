"""launch_ros/event_handlers/on_state_transition.py."""

from __future__ import annotations

from typing import Any

from launch_ros.actions import LifecycleNode


class OnStateTransition:
    def __init__(
        self,
        *,
        entities: Any,
        target_lifecycle_node: Any = None,
        transition: Any = None,
        start_state: Any = None,
        goal_state: Any = None,
        matcher: Any = None,
        handle_once: bool = False,
    ) -> None:
        if not isinstance(target_lifecycle_node, LifecycleNode | None):
            raise RuntimeError("OnStateTransition requires a 'LifecycleNode' action as the target")  # noqa: TRY004
        self.handle_once = handle_once
        self.entities, self.start_state, self.goal_state = entities, start_state, goal_state
