"""Names of nodes and topics: rules, expansion and remapping.

The rules are those that ``rcl`` checks (https://design.ros2.org/articles/topic_and_service_names.html);
remapping follows https://design.ros2.org/articles/static_remapping.html, global rules only.
"""

from __future__ import annotations

import re
from collections.abc import Mapping

from rosplc.errors import BackendError

_TOKEN = re.compile(r"[A-Za-z_][A-Za-z0-9_]*\Z")
_DDS_TYPE = re.compile(r"(\w+)::(\w+)::dds_::(\w+)_\Z", re.ASCII)
LONGEST_NAME = 247  # RMW_TOPIC_MAX_NAME_LENGTH: 255 less the prefixes of the middleware


def _refuse(kind: str, name: object, why: str) -> BackendError:
    return BackendError("ROS005", f"{kind} name {name!r} is not valid: {why}")


def _check(kind: str, name: str) -> None:
    if not isinstance(name, str) or not name.startswith("/"):
        raise _refuse(kind, name, "a full name must start with /")
    if len(name) > LONGEST_NAME:
        raise _refuse(kind, name, f"it has {len(name)} characters; the limit is {LONGEST_NAME}")
    for token in name[1:].split("/"):
        if not token:
            raise _refuse(kind, name, "it ends with / or contains //")
        if not _TOKEN.match(token):
            why = f"{token!r} may contain only letters, digits and _, and not start with a digit"
            raise _refuse(kind, name, why)


def validate_topic(name: str) -> str:
    """Return an absolute topic name such as ``/robot1/cmd_vel`` unchanged; ROS005 if it breaks a rule."""
    _check("topic", name)
    return name


def validate_namespace(name: str) -> str:
    """Return an absolute namespace such as ``/`` or ``/robot1`` unchanged; ROS005 if it breaks a rule."""
    if name != "/":
        _check("namespace", name)
    return name


def validate_node_name(name: str) -> str:
    """Return a node's base name, such as ``rosplc_cell1``, unchanged; ROS005 if it breaks a rule."""
    if not isinstance(name, str) or not _TOKEN.match(name):
        raise _refuse("node", name, "it may contain only letters, digits and _, and not start with a digit")
    if len(name) > 255:
        raise _refuse("node", name, "the limit is 255 characters")
    return name


def dds_type_name(name: str) -> str:
    """Return ``std_msgs::msg::dds_::String_`` for ``std_msgs/msg/String``."""
    package, kind, base = name.split("/")
    return f"{package}::{kind}::dds_::{base}_"


def ros_type_name(name: str) -> str:
    """Undo :func:`dds_type_name`; other names are returned as they are."""
    found = _DDS_TYPE.match(name)
    return "/".join(found.groups()) if found else name


def service_type_name(name: str) -> str:
    """Undo :func:`dds_type_name` for a service's request or response; the name is the service's."""
    found = ros_type_name(name)
    return found if found == name else re.sub("_(?:Request|Response)$", "", found)


def join(namespace: str, name: str) -> str:
    """Return ``name`` inside ``namespace``: ``/`` and ``talker`` give ``/talker``."""
    return f"{namespace.rstrip('/')}/{name}"


def resolve_topic(
    name: str, *, namespace: str = "/", node_name: str = "", remap: Mapping[str, str] | None = None
) -> str:
    """Expand a topic name (absolute, relative, or private with ``~``) and remap it.

    Both sides of a rule of ``remap`` are expanded the same way before they are compared.

    Raises BackendError: ROS005 if the result breaks a rule.
    """

    def expand(text: str) -> str:
        if text.startswith("/"):
            return text
        if text == "~" or text.startswith("~/"):
            return join(namespace, node_name) + text[1:]
        return join(namespace, text)

    full = validate_topic(expand(name))
    for source, target in (remap or {}).items():
        if expand(source) == full:
            return validate_topic(expand(target))
    return full
