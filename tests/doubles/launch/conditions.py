"""launch/conditions/if_condition.py."""

from __future__ import annotations

from typing import Any


class IfCondition:
    def __init__(self, predicate_expression: Any) -> None:
        self.predicate = predicate_expression
