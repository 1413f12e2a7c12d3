"""Names of ROS inside Zenoh's key expressions: topics, types, and names in one chunk of a key.

The conventions are those of ``rmw_zenoh_cpp`` (its ``docs/design.md`` and ``liveliness_utils``).
"""

from __future__ import annotations

import re

__all__ = ["NO_TYPE_HASH", "dds_type_name", "demangle", "mangle", "ros_type_name", "topic_key"]

NO_TYPE_HASH = "TypeHashNotSupported"
"""Stands for the type hash on Humble, which has none."""

_DDS_TYPE = re.compile(r"(\w+)::(\w+)::dds_::(\w+)_\Z", re.ASCII)


def dds_type_name(name: str) -> str:
    """Return ``std_msgs::msg::dds_::String_`` for ``std_msgs/msg/String``."""
    package, kind, base = name.split("/")
    return f"{package}::{kind}::dds_::{base}_"


def ros_type_name(name: str) -> str:
    """Undo :func:`dds_type_name`; other names are returned as they are."""
    found = _DDS_TYPE.match(name)
    return "/".join(found.groups()) if found else name


def topic_key(domain: int, topic: str, type_name: str, type_hash: str) -> str:
    """Return the key that a topic's messages are put on.

    Args:
        domain: The ROS domain.
        topic: The absolute topic name.
        type_name: The ROS type name.
        type_hash: The type hash, or :data:`NO_TYPE_HASH`.
    """
    return f"{domain}/{topic.strip('/')}/{dds_type_name(type_name)}/{type_hash}"


def mangle(name: str) -> str:
    """Return a name as one chunk of a key: ``/`` becomes ``%``, which no ROS name has."""
    return name.replace("/", "%")


def demangle(chunk: str) -> str:
    """Undo :func:`mangle`."""
    return chunk.replace("%", "/")
