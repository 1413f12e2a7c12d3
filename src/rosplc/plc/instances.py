"""Names of the function block instances: one per topic, within a variable list."""

from __future__ import annotations

import hashlib
from collections import Counter
from collections.abc import Sequence

from rosplc.plc.names import Scope, legal

__all__ = ["instance_names", "plain_name"]


def plain_name(topic: str) -> str:
    """Return what a topic's instance is called if nothing speaks against it: ``robot1_pose``."""
    return topic.strip("/").replace("/", "_")


def instance_names(topics: Sequence[str]) -> dict[str, str]:
    """Return the instance name of each topic of a variable list.

    Where topics would share a name, every one of them gets a suffix from its topic, so that one
    more topic makes programs fail to compile, but never makes a name stand for another topic.
    """
    count = Counter(legal(plain_name(topic)).upper() for topic in topics)
    scope = Scope(name for name, times in count.items() if times > 1)
    names: dict[str, str] = {}
    for topic in sorted(topics):
        name = legal(plain_name(topic))
        if count[name.upper()] > 1:
            name += f"_{hashlib.sha256(topic.encode()).hexdigest()[:4]}"
        names[topic] = scope.give(name)
    return names
