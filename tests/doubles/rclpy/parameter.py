"""rclpy/parameter.py."""

from __future__ import annotations

from enum import Enum
from typing import Any


class Parameter:
    class Type(Enum):
        NOT_SET = 0
        BOOL = 1
        INTEGER = 2
        DOUBLE = 3
        STRING = 4
        STRING_ARRAY = 9

    def __init__(self, name: str, type_: Any = None, value: Any = None) -> None:
        if type_ is None:
            type_ = _type_of(value)
        assert isinstance(type_, Parameter.Type)
        self.name, self.type_, self.value = name, type_, value


def _type_of(value: Any) -> Parameter.Type:
    if isinstance(value, list) and value and all(isinstance(one, str) for one in value):
        return Parameter.Type.STRING_ARRAY
    kinds = {bool: "BOOL", int: "INTEGER", float: "DOUBLE", str: "STRING", type(None): "NOT_SET"}
    if type(value) not in kinds:
        raise TypeError(f"The given value is not one of the allowed types '{value}'.")
    return Parameter.Type[kinds[type(value)]]
