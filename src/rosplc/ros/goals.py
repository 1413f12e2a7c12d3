"""The states of goals, and the messages that ROS 2 derives from an action's definition."""

from __future__ import annotations

import enum
from collections.abc import Iterable, Mapping
from typing import Any

from rosplc.errors import BackendError
from rosplc.model import TypeStore
from rosplc.ros import fields


class GoalStatus(enum.IntEnum):
    """The states of a goal, as ``action_msgs/msg/GoalStatus`` numbers them."""

    UNKNOWN = 0
    ACCEPTED = 1
    EXECUTING = 2
    CANCELING = 3
    SUCCEEDED = 4
    CANCELED = 5
    ABORTED = 6

    @property
    def ended(self) -> bool:
        """Whether the goal has a result."""
        return self >= GoalStatus.SUCCEEDED


class GoalStep(enum.IntEnum):
    """The transitions between states, with the numbers of rcl_action's events."""

    EXECUTE = 0
    CANCEL = 1
    SUCCEED = 2
    ABORT = 3
    CANCELED = 4


_S, _T = GoalStatus, GoalStep
STEPS: dict[tuple[GoalStatus, GoalStep], GoalStatus] = {
    (_S.ACCEPTED, _T.EXECUTE): _S.EXECUTING,
    (_S.ACCEPTED, _T.CANCEL): _S.CANCELING,
    (_S.EXECUTING, _T.CANCEL): _S.CANCELING,
    (_S.EXECUTING, _T.SUCCEED): _S.SUCCEEDED,
    (_S.EXECUTING, _T.ABORT): _S.ABORTED,
    (_S.CANCELING, _T.SUCCEED): _S.SUCCEEDED,
    (_S.CANCELING, _T.ABORT): _S.ABORTED,
    (_S.CANCELING, _T.CANCELED): _S.CANCELED,
}
"""The state machine of rcl_action; every other step is refused."""


class CancelCode(enum.IntEnum):
    """The result of a request to cancel, with the numbers of ``action_msgs/srv/CancelGoal``."""

    NONE = 0
    REJECTED = 1
    UNKNOWN_GOAL_ID = 2
    GOAL_TERMINATED = 3


# The messages that ROS 2 makes of an action's own: with a goal's UUID before them, or a status. A UUID has 16
# bytes, a multiple of every alignment of CDR: what follows it is encoded as if it came first. Behind the one
# byte of a result's status that does not hold: a result is read and written again.
LITTLE = b"\0\1\0\0"  # the header of plain CDR, little-endian
STATUSES, CANCELS = "action_msgs/msg/GoalStatusArray", "action_msgs/srv/CancelGoal"

GoalInfo = tuple[bytes, int]  # UUID, and the time of acceptance in ns since 1970
KnownGoal = tuple[bytes, int, int]  # the same, and the goal's status


def _info(uuid: bytes, stamp_ns: int) -> dict[str, Any]:
    return {"goal_id": {"uuid": uuid}, "stamp": fields.time(stamp_ns)}


def _read_info(info: Mapping[str, Any]) -> GoalInfo:
    return bytes(info["goal_id"]["uuid"]), info["stamp"]["sec"] * 10**9 + info["stamp"]["nanosec"]


def wrap(uuid: bytes, payload: bytes) -> bytes:
    """Return the request to send a goal, or the message that carries feedback."""
    return payload[:4] + uuid + payload[4:]


def unwrap(payload: bytes) -> tuple[bytes, bytes]:
    """Return the UUID and goal or feedback; empty for a request for a result. ROS008 if too short."""
    if len(payload) < 20:
        raise BackendError("ROS008", f"an action message has {len(payload)} bytes, but needs at least 20")
    return payload[4:20], payload[:4] + payload[20:]


class Messages:
    """Writes and reads the other messages of an action; ROS008 if bytes do not fit."""

    def __init__(self, store: TypeStore, action: str) -> None:
        self._store, self._result, self._response = store, f"{action}_Result", f"{action}_GetResult_Response"
        self._decision = f"{action}_SendGoal_Response"

    def pack_accepted(self, accepted: bool, stamp_ns: int) -> bytes:
        """Return the response to a goal."""
        values = {"accepted": accepted, "stamp": fields.time(stamp_ns)}
        return fields.pack(self._store, self._decision, values)

    def read_accepted(self, payload: bytes) -> bool:
        """Return whether a goal was accepted."""
        return bool(fields.unpack(self._store, self._decision, payload)["accepted"])

    def pack_cancel(self, uuid: bytes, stamp_ns: int = 0) -> bytes:
        """Return the request to cancel goals."""
        return fields.pack(self._store, f"{CANCELS}_Request", {"goal_info": _info(uuid, stamp_ns)})

    def read_cancel(self, payload: bytes) -> GoalInfo:
        """Return the UUID and the time of a request to cancel."""
        return _read_info(fields.unpack(self._store, f"{CANCELS}_Request", payload)["goal_info"])

    def pack_canceling(self, code: int, goals: Iterable[GoalInfo]) -> bytes:
        """Return the response to a request to cancel."""
        values = {"return_code": code, "goals_canceling": [_info(*goal) for goal in goals]}
        return fields.pack(self._store, f"{CANCELS}_Response", values)

    def read_canceling(self, payload: bytes) -> tuple[int, list[GoalInfo]]:
        """Return code and goals of the response to a request to cancel."""
        values = fields.unpack(self._store, f"{CANCELS}_Response", payload)
        return values["return_code"], [*map(_read_info, values["goals_canceling"])]

    def pack_statuses(self, goals: Iterable[KnownGoal]) -> bytes:
        """Return the message of the status topic."""
        known = [{"goal_info": _info(*goal[:2]), "status": goal[2]} for goal in goals]
        return fields.pack(self._store, STATUSES, {"status_list": known})

    def read_statuses(self, payload: bytes) -> list[KnownGoal]:
        """Return the goals in a message of the status topic."""
        known = fields.unpack(self._store, STATUSES, payload)["status_list"]
        return [(*_read_info(one["goal_info"]), one["status"]) for one in known]

    def pack_result(self, status: int, result: bytes | None) -> bytes:
        """Return the response with a result; an empty one for None."""
        values = {} if result is None else fields.unpack(self._store, self._result, result)
        return fields.pack(self._store, self._response, {"status": status, "result": values})

    def read_result(self, payload: bytes) -> tuple[int, bytes]:
        """Return status and result of a response."""
        values = fields.unpack(self._store, self._response, payload)
        return values["status"], fields.pack(self._store, self._result, values["result"])
