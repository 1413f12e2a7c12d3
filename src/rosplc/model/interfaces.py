"""Services and actions: ``.srv`` and ``.action`` text → its parts, and the messages that ROS adds to them.

ROS 2's generator adds an event to a service; to an action two services and the message that carries its
feedback (https://design.ros2.org/articles/actions.html). ROS 1's adds the messages that wrap an action's
parts (http://wiki.ros.org/actionlib/DetailedDescription).
"""

from __future__ import annotations

import re
from collections.abc import Collection
from dataclasses import replace

from rosplc.errors import MessageTypeError
from rosplc.model.parse import ParsedType, parse_definition
from rosplc.model.types import ArrayType, Field, MessageType, NamedType, PrimitiveType, SequenceType

# Kind of interface → what its parts are called, in the order of the text.
PARTS = {"srv": ("Request", "Response"), "action": ("Goal", "Result", "Feedback")}

_TIME = NamedType("builtin_interfaces/msg/Time")
_GOAL_ID = Field("goal_id", NamedType("unique_identifier_msgs/msg/UUID"))
# Humble has no such message, and no hashes either; so that a service can be described there too.
EVENT_INFO = MessageType(
    "service_msgs/msg/ServiceEventInfo",
    (
        Field("event_type", PrimitiveType("uint8")),
        Field("stamp", _TIME),
        Field("client_gid", ArrayType(PrimitiveType("char"), 16)),
        Field("sequence_number", PrimitiveType("int64")),
    ),
)

_ROS1_PART = re.compile(r"(Goal|Result|Feedback)\Z")


def kind_of(name: str) -> str:
    """Return ``msg``, ``srv`` or ``action`` for a full name."""
    return name.rpartition("/")[0].rpartition("/")[2]


def owners_of(name: str, ros_version: int) -> list[str]:
    """Return the services and actions that a message of this full name may belong to."""
    if kind_of(name) != "msg":
        # Name_Goal, or Name_SendGoal_Request
        return [owner for n in (1, 2) if (owner := name.rsplit("_", n)[0]).count("/") == 2]
    if ros_version == 2:
        return []
    owner = _ROS1_PART.sub("", name).replace("/msg/", "/action/")
    return [owner, owner.removesuffix("Action")]


def parse_interface(
    name: str, text: str, *, where: str, ros_version: int, siblings: Collection[str] = ()
) -> list[ParsedType]:
    """Parse the text of a service or an action by its full name; return its parts.

    Lines of ``---`` separate them; in ROS 1 any line that begins so does, and a service without one has an
    empty response. ``where`` and ``siblings`` are as of :func:`~rosplc.model.parse.parse_definition`. Raises
    MessageTypeError TYP002, TYP004 or TYP007.
    """
    parts = PARTS[kind_of(name)]
    lines = text.split("\n")
    if ros_version == 1:
        cuts = [number for number, line in enumerate(lines) if line.lstrip().startswith("---")]
    else:
        cuts = [number for number, line in enumerate(lines) if line.rstrip("\r") == "---"]
    if ros_version == 1 and not cuts and len(parts) == 2:
        cuts = [len(lines)]
    if len(cuts) != len(parts) - 1:
        line = cuts[len(parts) - 1] if len(cuts) >= len(parts) else len(lines) - 1
        what = f"expected {len(parts) - 1} × `---` between {', '.join(parts).lower()}; found {len(cuts)}"
        raise MessageTypeError("TYP002", what, where=f"{where}:{line + 1}")
    found: list[ParsedType] = []
    for part, start, end in zip(parts, [-1, *cuts], [*cuts, len(lines)], strict=True):
        own = "\n" * (start + 1) + "\n".join(lines[start + 1 : end])  # with the lines' own numbers
        parsed, *others = parse_definition(
            f"{name}_{part}", own, where=where, ros_version=ros_version, siblings=siblings
        )
        if others:
            raise MessageTypeError("TYP002", "this file cannot define other types", where=others[0].where)
        found.append(parsed)
    return found


def describe(name: str) -> list[MessageType]:
    """Return the descriptions that ROS 2 hashes for a service or action, its own first."""
    if kind_of(name) == "srv" or name.endswith(("_SendGoal", "_GetResult")):
        return [
            _of_parts(name, request_message="Request", response_message="Response", event_message="Event")
        ]
    services = {"send_goal_service": "SendGoal", "get_result_service": "GetResult"}
    parts = {part.lower(): part for part in PARTS["action"]}
    own = _of_parts(name, **parts, **services, feedback_message="FeedbackMessage")
    return [own, *(describe(f"{name}_{service}")[0] for service in services.values())]


def derive(name: str, parts: list[MessageType], ros_version: int) -> list[MessageType]:
    """Return the messages that ROS adds to the parts of a service or action."""
    if ros_version == 1:
        return [] if kind_of(name) == "srv" else _wrappers(name, parts)
    if kind_of(name) == "srv":
        return [_event(name)]
    send, get = f"{name}_SendGoal", f"{name}_GetResult"
    messages = {
        f"{send}_Request": (_GOAL_ID, Field("goal", NamedType(f"{name}_Goal"))),
        f"{send}_Response": (Field("accepted", PrimitiveType("bool")), Field("stamp", _TIME)),
        f"{get}_Request": (_GOAL_ID,),
        f"{get}_Response": (
            Field("status", PrimitiveType("int8")),
            Field("result", NamedType(f"{name}_Result")),
        ),
        f"{name}_FeedbackMessage": (_GOAL_ID, Field("feedback", NamedType(f"{name}_Feedback"))),
    }
    return [*(MessageType(own, fields) for own, fields in messages.items()), _event(send), _event(get)]


def _of_parts(name: str, **parts: str) -> MessageType:
    return MessageType(
        name, tuple(Field(field, NamedType(f"{name}_{part}")) for field, part in parts.items())
    )


def _event(name: str) -> MessageType:
    fields = [Field(part.lower(), SequenceType(NamedType(f"{name}_{part}"), 1)) for part in PARTS["srv"]]
    return MessageType(f"{name}_Event", (Field("info", NamedType(EVENT_INFO.name)), *fields))


def _wrappers(name: str, parts: list[MessageType]) -> list[MessageType]:
    own = name.replace("/action/", "/msg/")
    renamed = [replace(each, name=f"{own}{part}") for each, part in zip(parts, PARTS["action"], strict=True)]
    header = Field("header", NamedType("std_msgs/msg/Header"))
    status = Field("status", NamedType("actionlib_msgs/msg/GoalStatus"))
    second = {"Goal": Field("goal_id", NamedType("actionlib_msgs/msg/GoalID")), "Result": status}
    wrappers = {
        part: MessageType(
            f"{own}Action{part}",
            (header, second.get(part, status), Field(part.lower(), NamedType(f"{own}{part}"))),
        )
        for part in PARTS["action"]
    }
    fields = [Field(f"action_{part.lower()}", NamedType(each.name)) for part, each in wrappers.items()]
    return [*renamed, *wrappers.values(), MessageType(f"{own}Action", tuple(fields))]
