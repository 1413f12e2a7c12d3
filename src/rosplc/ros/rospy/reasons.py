"""In words, why a peer is not connected."""

from __future__ import annotations

from rosplc.ros.rospy.handshake import ANY

__all__ = ["mismatch", "unreachable"]


def mismatch(
    node: str, verb: str, topic: str, theirs: tuple[str, str], ours: tuple[str, str]
) -> tuple[str, str] | None:
    """Return code and words if two types are not the same; None if they are.

    Args:
        node: The peer's full name.
        verb: ``publishes`` or ``subscribes to``.
        topic: The topic.
        theirs: The peer's type name and MD5 sum; ``*`` stands for any.
        ours: Ours.
    """
    (name, md5), (own_name, own_md5) = theirs, ours
    does = f"node {node} {verb} {topic} as {name}"
    if name not in (ANY, own_name):
        return "ROS003", f"{does}, here it is {own_name}"
    if md5 not in (ANY, own_md5):
        does = does if name != ANY else f"node {node} {verb} {topic}"
        return "ROS003", f"{does} with another definition (md5 {md5} there, {own_md5} here)"
    return None


def unreachable(node: str, verb: str, topic: str, what: str) -> str:
    """Return words for a peer that cannot be reached, or cannot reach us."""
    return f"{node} {verb} {topic}, but {what}"
