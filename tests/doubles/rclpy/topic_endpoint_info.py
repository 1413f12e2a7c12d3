"""rclpy/topic_endpoint_info.py."""

from __future__ import annotations

from enum import IntEnum
from typing import Any

from rclpy._distro import HUMBLE


class TopicEndpointTypeEnum(IntEnum):
    INVALID = 0
    PUBLISHER = 1
    SUBSCRIPTION = 2


_SLOTS = {"node_name", "node_namespace", "topic_type", "endpoint_type", "endpoint_gid", "qos_profile"}
if not HUMBLE:
    _SLOTS.add("topic_type_hash")


class TopicEndpointInfo:
    __slots__ = [f"_{name}" for name in sorted(_SLOTS)]

    def __init__(self, **kwargs: Any) -> None:
        assert kwargs.keys() <= _SLOTS, f"Invalid arguments passed to constructor: {kwargs.keys()!r}"
        for name in _SLOTS:
            setattr(self, f"_{name}", kwargs[name])


def _field(name: str) -> property:
    return property(lambda self: getattr(self, f"_{name}"))


for _name in _SLOTS:
    setattr(TopicEndpointInfo, _name, _field(_name))
